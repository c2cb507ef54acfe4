"""Measure how commands meet hostile answers of servers: hangs, tracebacks, strangers, lines, memory.

Each answer of the table in tests/support/web/hostile_server.py is given to a command that asks for
a tileset, a tile, an archive, a splat file, a model, cameras, an address without a suffix, and a
file of the Hub; a file may take two seconds. Prints each miss, and each figure with its bar; exits
1 if one is missed.

    .venv/bin/python tests/bench/bench_hostile_answers.py [DOOR]…
"""

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.tiles import foreign_tiles as foreign
from support.web.hostile_server import ANSWERS, hostile_server

FETCH_SECONDS = "2"
MOST_SECONDS, MOST_MEGABYTES = 10.0, 300
KILLED_AFTER = 60.0
TILE = {"boundingVolume": foreign.box(100), "geometricError": 0, "refine": "ADD"}
INDEX = foreign.tileset({**TILE, "content": {"uri": "x.glb"}})
# Door → the file that is asked for, and the command that asks for it.
DOORS = {
    "index": ("tileset.json", ["tiles", "info", "ADDRESS"]),
    "tile": ("tileset.json", ["convert", "ADDRESS", "OUTPUT"]),
    "archive": ("a.3tz", ["tiles", "info", "ADDRESS"]),
    "file": ("a.ply", ["convert", "ADDRESS", "OUTPUT"]),
    "model": ("a.onnx", ["inspect", "ADDRESS"]),
    "cameras": ("transforms.json", ["render", "MISSING", "--camera", "ADDRESS", "-o", "OUTPUT"]),
    "suffixless": ("download", ["convert", "ADDRESS", "OUTPUT"]),
    "hub": ("a.ply", ["convert", "hf://owner/name/a.ply", "OUTPUT"]),
}


@dataclass(frozen=True)
class Outcome:
    """What a command did with an answer."""

    door: str
    answer: str
    seconds: float
    megabytes: float
    code: int
    text: str
    strangers: int

    @property
    def misses(self) -> list[str]:
        """The bars that the command missed."""
        messages = [line for line in self.text.splitlines() if not line.startswith(" ")]
        failed = {
            "hang": self.seconds > MOST_SECONDS,
            "traceback": "Traceback" in self.text,
            "exit code": self.code != 4,
            "lines": len(messages) != 1,
            "memory": self.megabytes > MOST_MEGABYTES,
            "stranger": self.strangers > 0,
        }
        return [name for name, is_failed in failed.items() if is_failed]


def main() -> int:
    """Run all answers through all doors."""
    doors = sys.argv[1:] or list(DOORS)
    with (
        tempfile.TemporaryDirectory() as folder,
        ThreadPoolExecutor(2 * (os.cpu_count() or 1)) as pool,
    ):
        outcomes = list(pool.map(partial(_run, Path(folder)), product(doors, ANSWERS)))
    for outcome in outcomes:
        if outcome.misses:
            print(f"{outcome.door}, {outcome.answer}: {', '.join(outcome.misses)}; {outcome.text}")
    misses = [miss for outcome in outcomes for miss in outcome.misses]
    print(f"{len(ANSWERS)} answers, {len(doors)} doors, {len(outcomes)} commands")
    for name in ("hang", "traceback", "stranger", "exit code", "lines"):
        print(f"{name:<12} {misses.count(name)}; bar 0")
    print(f"longest      {max(o.seconds for o in outcomes):.1f} s; bar {MOST_SECONDS:g} s")
    print(f"most memory  {max(o.megabytes for o in outcomes):.0f} MB; bar {MOST_MEGABYTES} MB")
    return int(bool(misses))


def _run(folder: Path, case: tuple[str, str]) -> Outcome:
    door, answer = case
    name, words = DOORS[door]
    files = {"/a/tileset.json": INDEX} if door == "tile" else {}
    with hostile_server(ANSWERS[answer], files) as server:
        replaced = {
            "ADDRESS": server.address_of(name),
            "OUTPUT": str(folder / f"{answer}.ply"),
            "MISSING": str(folder / "missing.ply"),
        }
        command = [sys.executable, "-m", "gsgen.cli", *(replaced.get(word, word) for word in words)]
        with tempfile.TemporaryFile("w+") as output:
            start = time.monotonic()
            environment = {
                **os.environ,
                "GSGEN_FETCH_SECONDS": FETCH_SECONDS,
                # The hub may lead to other ports of its host: strangers are 127.0.0.1.
                "HF_ENDPOINT": f"http://localhost:{server.port}",
                "HF_TOKEN": "hf_secret",
            }
            process = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
            while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
                if time.monotonic() - start > KILLED_AFTER:
                    process.kill()
                time.sleep(0.02)
            seconds = time.monotonic() - start
            process.returncode = os.waitstatus_to_exitcode(ended[1])  # it was waited for here
            output.seek(0)
            return Outcome(
                door=door,
                answer=answer,
                seconds=seconds,
                megabytes=ended[2].ru_maxrss / 1024,
                code=process.returncode,
                text=output.read(),
                strangers=server.strangers,
            )


if __name__ == "__main__":
    raise SystemExit(main())

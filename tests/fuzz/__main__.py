"""Fuzz the validator: thousands of mutants, judged on every core, each within limits.

Run by ``make fuzz``. A run that was stopped goes on where it was; ``--only`` judges one case again.
"""

import argparse
import json
import os
import shutil
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.progress import TimeRemainingColumn as Remaining

from fuzz.case import draw
from fuzz.corpus import bases
from fuzz.judging import judge
from fuzz.pool import Pool


def main() -> int:
    """Run as the command line says; 1 where something failed."""
    arguments = _arguments()
    if arguments.only is not None:
        return _run_single_case(arguments.seed, arguments.only)
    folder = arguments.folder / f"seed-{arguments.seed}"
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "cases.jsonl"
    done = _read_log(log)
    todo = [index for index in range(arguments.count) if index not in done]
    deadline = time.monotonic() + 60 * arguments.minutes
    failed = sum(bool(outcome["failures"]) for outcome in done.values())
    with log.open("a") as out, _bar() as bar, suppress(KeyboardInterrupt):
        task = bar.add_task("", total=arguments.count, completed=arguments.count - len(todo))
        for result in Pool(arguments.seed, arguments.jobs).judged(todo, deadline):
            done[result["case"]] = result
            out.write(json.dumps(result) + "\n")
            out.flush()
            if result["failures"]:
                failed += 1
                _save_failure(arguments.seed, result, folder)
                bar.console.print(f"case {result['case']}: {result['failures'][0][-300:]}")
            bar.update(task, advance=1, description=f"{failed} failed")
    return _sum_up(
        [outcome for index, outcome in done.items() if index < arguments.count], arguments, folder
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="how many cases")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other cases")
    parser.add_argument("--minutes", type=float, default=90, help="stop after so long")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--folder", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--only", type=int, help="judge one case, and say what became of it")
    return parser.parse_args()


def _bar() -> Progress:
    console = Console(stderr=True)
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), Remaining())
    shown = [TextColumn(column) if isinstance(column, str) else column for column in columns]
    return Progress(*shown, console=console, disable=not console.is_terminal)


def _read_log(log: Path) -> dict[int, dict[str, Any]]:
    """Return what an earlier run of the same seed judged; a half-written line is its end."""
    done: dict[int, dict[str, Any]] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        try:
            document = json.loads(line)
        except ValueError:
            continue
        done[document["case"]] = document
    return done


def _save_failure(seed: int, result: dict[str, Any], folder: Path) -> None:
    """Write what is needed to see a failure again: the model, what is beside it, the commands."""
    kept_path = folder / "failures" / str(result["case"])
    shutil.rmtree(kept_path, ignore_errors=True)
    kept_path.mkdir(parents=True)
    case = draw(seed, result["case"], bases(kept_path))
    for path in kept_path.iterdir():
        if case.base.folder is None or path != case.base.folder:
            shutil.rmtree(path)
    base_folder = case.base.folder or kept_path
    (base_folder / "model.onnx").write_bytes(case.content)
    command = (
        f"PYTHONPATH=tests python -m fuzz --seed {seed} --only {result['case']}\n"
        f"gsgen validate {base_folder / 'model.onnx'} --level {case.level.word} --target {case.target}\n"
    )
    (kept_path / "reproduce.sh").write_text(command)
    (kept_path / "case.json").write_text(json.dumps({"seed": seed, **result}, indent=2))


def _run_single_case(seed: int, index: int) -> int:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        case = draw(seed, index, bases(Path(name)))
        path = (case.base.folder or Path(name)) / "model.onnx"
        path.write_bytes(case.content)
        verdict = judge(case, path)
    sys.stdout.write(f"{case.base.name}, {', '.join(case.mutations)}: {verdict.word}\n")
    for failure in verdict.failures:
        sys.stdout.write(f"{failure}\n")
    return 1 if verdict.failures else 0


def _sum_up(done: list[dict[str, Any]], arguments: argparse.Namespace, folder: Path) -> int:
    words = Counter(outcome["verdict"] for outcome in done)
    failed = [outcome["case"] for outcome in done if outcome["failures"]]
    slowest = max((outcome["seconds"] for outcome in done), default=0.0)
    largest = max((outcome.get("peak", 0) for outcome in done), default=0)
    parts = ", ".join(f"{count} {word}" for word, count in sorted(words.items()))
    completed = sum(outcome["ran"] for outcome in done)
    sys.stdout.write(
        f"fuzz, seed {arguments.seed}: {len(done)} of {arguments.count} mutants ({parts}), "
        f"{completed} reached ONNX Runtime; slowest {slowest:.1f} s, "
        f"peak {largest / (1 << 20):.0f} MiB; {len(failed)} failed\n"
    )
    if failed:
        sys.stdout.write(f"kept in {folder / 'failures'}: {failed[:20]}\n")
    elif len(done) < arguments.count:
        sys.stdout.write("not all were judged: the same command goes on from here\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

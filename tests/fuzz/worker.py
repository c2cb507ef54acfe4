"""A process that judges mutants: it reads a number a line, and writes a line of JSON for each."""

__all__ = ["main"]

import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from fuzz.case import Case, draw
from fuzz.corpus import bases
from fuzz.judging import MEMORY, judge, peak


def main(seed: int) -> None:
    """Judge the cases whose numbers come in, until no more come."""
    most = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (2 * MEMORY, most))
    with tempfile.TemporaryDirectory(prefix="gsgen-fuzz-") as name:
        folder = Path(name)
        corpus = bases(folder)
        _say({"ready": len(corpus)})
        for line in sys.stdin:
            _say(_run_case(draw(seed, int(line), corpus), folder))


def _run_case(case: Case, scratch: Path) -> dict[str, Any]:
    folder = case.base.folder or scratch
    path = folder / f"case_{case.index}.onnx"
    path.write_bytes(case.content)
    start_time = time.perf_counter()
    try:
        verdict = judge(case, path)
    finally:
        path.unlink()
    failures = list(verdict.failures)
    if peak() > MEMORY:
        failures.append(f"{peak() >> 20} MiB of memory")
    return {
        "case": case.index,
        "verdict": verdict.word,
        "ran": verdict.ran,
        "mutations": case.mutations,
        "seconds": round(time.perf_counter() - start_time, 4),
        "peak": peak(),
        "failures": failures,
    }


def _say(label: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(label) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]))

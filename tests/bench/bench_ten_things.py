"""Print what four commands do with ten things that people open first.

Each cell is the file that was written, or the error with what to do. Exits 1 if a cell is neither
a result nor one sentence with a hint.

    .venv/bin/python tests/bench/bench_ten_things.py
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.ten_things import COMMANDS, Answer, answer, ten_things


def main() -> int:
    """Run every command on every thing."""
    faults = 0
    with tempfile.TemporaryDirectory() as folder, ten_things(Path(folder)) as things:
        for name, thing in things.items():
            print(f"{name}: {thing}")
            for command in COMMANDS:
                entry = answer(command, thing, Path(folder))
                faults += bool(entry.fault)
                print(f"  {command:<13} {entry.code}  {_cell(entry)}")
    cells = len(things) * len(COMMANDS)
    print(f"{cells} cells; {faults} neither a result nor one sentence with a hint, bar 0")
    return int(faults > 0)


def _cell(entry: Answer) -> str:
    if entry.fault:
        return f"FAULT: {entry.fault}: {' | '.join(entry.errors)}"
    if entry.files:
        return ", ".join(entry.files)
    text = entry.errors[0] if entry.errors else entry.out.splitlines()[0]
    return " → ".join(" ".join(line.split()) for line in text.splitlines())


if __name__ == "__main__":
    raise SystemExit(main())

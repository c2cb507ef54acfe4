"""What gsgen makes of files that an attacker wrote: one line each, or a fault is listed.

    python tests/bench/bench_untrusted_bytes.py [models] [pickles] [motions] [scripts] [fuzz]

The bars: no crash, no traceback, no internal error, no byte of a file outside the model's folder in
an output, and for each file one message within 10 s of processor time and 300 MB.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import patch

from gsgen.cli.app import main as gsgen
from gsgen.formats import write_ply
from gsgen.reference_plugins.samples import garden
from support.hostile.model_escapes import (
    COMMANDS,
    ESCAPES,
    REPORTING,
    command_words,
    has_weights_of,
    write_escape,
)
from support.hostile.runs import run_forked
from support.measures import print_line

Fault = tuple[str, str]


def gsgen_action(words: list[str]) -> Callable[[], None]:
    """Return an action that runs a command line."""

    def action() -> None:
        with patch.object(sys, "argv", ["gsgen", *words]):
            gsgen()

    return action


def model_faults(folder: Path) -> Iterator[Fault]:
    """Yield the faults of every command that takes a model, on every escape."""
    refused = outcomes = 0
    for number, escape in enumerate(ESCAPES):
        for command in COMMANDS:
            place = write_escape(folder / f"{number} {command.replace(' ', '')}", escape)
            write_ply(place.inside / "scene.ply", garden(200))
            (place.inside / "out").mkdir()
            outcome = run_forked(gsgen_action(command_words(command)), place.inside)
            faults = outcome.faults()
            if command in REPORTING:
                faults = [fault for fault in faults if fault != "accepted" and "lines" not in fault]
            if has_weights_of(place.inside / "out"):
                faults.append("bytes from outside were copied")
            outcomes += 1
            refused += outcome.code != 0
            yield from ((f"gsgen {command}: {escape}", fault) for fault in faults)
    print_line(f"models: {outcomes} runs of {len(COMMANDS)} commands, {refused} with an error code")


PARTS = {"models": model_faults}


def main() -> int:
    """Run the named parts, all by default; print their figures, and return 1 if a bar is missed."""
    missed = 0
    for name in sys.argv[1:] or PARTS:
        with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
            faults = list(PARTS[name](Path(folder)))
        for where, fault in faults:
            print_line(f"  {where}: {fault}")
        print_line(f"{name}: {len(faults)} faults (bar 0)")
        missed += len(faults)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())

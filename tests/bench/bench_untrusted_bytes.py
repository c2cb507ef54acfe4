"""What gsgen makes of files that an attacker wrote: a message for each, or a fault is listed.

    python tests/bench/bench_untrusted_bytes.py [models] [motions] [pickles] [scripts] [random]

The bars: no crash, no traceback, no internal error, no byte of a file outside the model's folder in
an output, and for each file one message within 10 s of processor time and 300 MB. Random pickles
and headers, 20,000 of each, are read in a process whose memory the C library checks.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator, Sized
from pathlib import Path
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gsgen.cli.app import main as gsgen
from gsgen.conformance.fixtures import find
from gsgen.contract.errors import GsgenError
from gsgen.formats import write_ply
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.samples import garden
from support.hostile.model_escapes import (
    COMMANDS,
    ESCAPES,
    REPORTING,
    command_words,
    has_weights_of,
    write_escape,
)
from support.hostile.motions import MOTIONS, write_motion, zeros_bytes
from support.hostile.pickles import PICKLES, write_pickle
from support.hostile.random_bytes import run_checked
from support.hostile.runs import run_forked
from support.hostile.scripts import SCRIPTS, write_script
from support.measures import print_line

RANDOM_FILES = 20_000

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
            case = write_escape(folder / f"{number} {command.replace(' ', '')}", escape)
            write_ply(case.inside / "scene.ply", garden(200))
            (case.inside / "out").mkdir()
            outcome = run_forked(gsgen_action(command_words(command)), case.inside)
            faults = outcome.faults()
            if command in REPORTING:
                faults = [fault for fault in faults if fault != "accepted" and "lines" not in fault]
            if has_weights_of(case.inside / "out"):
                faults.append("bytes from outside were copied")
            outcomes += 1
            refused += outcome.code != 0
            yield from ((f"gsgen {command}: {escape}", fault) for fault in faults)
    print_line(f"models: {outcomes} runs of {len(COMMANDS)} commands, {refused} with an error code")


def motion_faults(folder: Path) -> Iterator[Fault]:
    """Yield the faults of ``gsgen render --pose`` on damaged motion files."""
    model = find("avatar_with_skeleton").write(folder)
    large = folder / "zeros_of_3_gb.npz"
    large.write_bytes(zeros_bytes(3 << 27))
    paths = [large, *(write_motion(folder, name) for name in (*MOTIONS, "pipe.npz", "pipe.json"))]
    for path in paths:
        words = ["render", str(model), "--pose", str(path), "-o", str(folder / "a.png")]
        yield from ((path.name, fault) for fault in run_forked(gsgen_action(words)).faults())
    print_line(f"motions: {len(paths)} files, the first of {large.stat().st_size} bytes")


def pickle_faults(folder: Path) -> Iterator[Fault]:
    """Yield the faults of reading hostile pickles of arrays."""
    read = 0
    for number, name in enumerate(PICKLES):
        case_folder = folder / str(number)
        case_folder.mkdir()
        path = write_pickle(case_folder, name)
        outcome = run_forked(
            reading_action(lambda p=path: read_array_pickle(p, ["x"])), case_folder
        )
        read += outcome.code == 0
        faults = [fault for fault in outcome.faults() if fault != "accepted"]
        if len(list(case_folder.iterdir())) > 1:
            faults.append("its code ran")
        yield from ((name, fault) for fault in faults)
    print_line(f"pickles: {len(PICKLES)} files, {read} of them harmless as data and read")


def script_faults(folder: Path) -> Iterator[Fault]:
    """Yield the faults of reading hostile TorchScript archives."""
    from gsgen.reference_plugins.loading.states import read_script_state  # imports torch

    read = 0
    for name in SCRIPTS:
        path = write_script(folder, name)
        outcome = run_forked(reading_action(lambda p=path: read_script_state(p)))
        read += outcome.code == 0
        faults = [fault for fault in outcome.faults() if fault != "accepted"]
        yield from ((name, fault) for fault in faults)
    print_line(f"scripts: {len(SCRIPTS)} archives, {read} of them harmless as data and read")


def random_faults(_: Path) -> Iterator[Fault]:
    """Yield the faults of reading random pickles and .npy headers under checks of memory."""
    for kind in ("pickles", "headers"):
        ended = run_checked(kind, RANDOM_FILES)
        print_line(f"random: {ended.stdout.strip()}")
        if ended.returncode:
            yield kind, f"exit code {ended.returncode}: {ended.stderr[-500:]}"


def reading_action(read: Callable[[], Sized]) -> Callable[[], None]:
    """Return an action that reads a file as a command does: an error is printed."""

    def action() -> None:
        try:
            print_line(f"{len(read())} arrays")
        except GsgenError as error:
            print_line(str(error))
            raise SystemExit(error.exit_code) from error

    return action


PARTS = {
    "models": model_faults,
    "motions": motion_faults,
    "pickles": pickle_faults,
    "scripts": script_faults,
    "random": random_faults,
}


def main() -> int:
    """Run the named parts, all by default; print their figures, and return 1 if a bar is missed."""
    missed = 0
    for name in sys.argv[1:] or PARTS:
        count = 0
        with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
            for where, fault in PARTS[name](Path(folder)):
                print_line(f"  {where}: {fault}")
                count += 1
        print_line(f"{name}: {count} faults (bar 0)")
        missed += count
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())

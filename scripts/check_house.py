"""Check the repository's own rules of style: names, phrases, sizes, imports, shaders.

Prints a line for each rule with its figure and its bar, and every violation of the rules that
fail. Exits 0 if all bars hold, 1 if one does not, 2 if a file or the table of exceptions cannot
be read.

    .venv/bin/python scripts/check_house.py [PATH…] [--only NAME…] [--list]
"""

import argparse
import gc
import sys
from pathlib import Path

from house.checks import CHECKS, Result, run_checks
from house.exceptions import ExceptionsInvalid, StyleException, read_exceptions
from house.repository import FileUnreadable, Repository

ROOT = Path(__file__).resolve().parents[1]
EXCEPTIONS = Path(__file__).parent / "house" / "exceptions.toml"


def main(arguments: list[str] | None = None) -> int:
    """Run the checks that the command line names, and return the exit code."""
    gc.disable()  # all syntax trees live until the end: half the time would go into looking for garbage
    options = _parser().parse_args(arguments)
    root: Path = options.root.resolve()
    selection = tuple(_from_root(path, root) for path in options.paths)
    checks = [check for check in CHECKS if not options.only or check.name in options.only]
    try:
        exceptions = read_exceptions(options.exceptions, {check.name for check in CHECKS})
        results = run_checks(Repository(root, selection), checks, exceptions)
    except (ExceptionsInvalid, FileUnreadable, OSError) as error:
        print(f"check_house: {error}", file=sys.stderr)
        return 2
    _print_violations(results, with_passed=options.list)
    if options.list:
        _print_exceptions(results)
    for result in results:
        print(result)
    complete = not selection and not options.only
    unused = _unused(exceptions, results) if complete else []
    for exception in unused:
        print(f"FAIL  exception permits nothing: {exception}; hint: remove it")
    return 0 if all(result.passed for result in results) and not unused else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("paths", nargs="*", type=Path, help="report these files and folders only")
    parser.add_argument(
        "--only",
        nargs="+",
        action="extend",
        metavar="NAME",
        choices=[check.name for check in CHECKS],
        help=f"run these checks only: {', '.join(check.name for check in CHECKS)}",
    )
    parser.add_argument(
        "--list", action="store_true", help="list violations of passed checks, and exceptions"
    )
    parser.add_argument("--root", type=Path, default=ROOT, help="folder of the checkout")
    parser.add_argument("--exceptions", type=Path, default=EXCEPTIONS, help="TOML table")
    return parser


def _from_root(path: Path, root: Path) -> str:
    """Return a path of the command line as the checks name it.

    Raises:
        SystemExit: It does not exist, or lies outside of the checkout.
    """
    resolved = path.resolve()
    if not resolved.exists() or not resolved.is_relative_to(root):
        print(f"check_house: {path}: expected a file or folder in {root}", file=sys.stderr)
        raise SystemExit(2)
    return resolved.relative_to(root).as_posix()


def _print_violations(results: list[Result], *, with_passed: bool) -> None:
    for result in results:
        if with_passed or not result.passed:
            for violation in result.violations:
                print(f"{result.check.name}: {violation}")


def _print_exceptions(results: list[Result]) -> None:
    for result in results:
        for exception in sorted(result.used, key=str):
            print(f"excepted: {exception}")


def _unused(exceptions: list[StyleException], results: list[Result]) -> list[StyleException]:
    """Return the entries that permitted no violation."""
    used = {exception for result in results for exception in result.used}
    return [exception for exception in exceptions if exception not in used]


if __name__ == "__main__":
    raise SystemExit(main())

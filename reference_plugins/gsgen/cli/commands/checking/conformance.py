"""The command `gsgen conformance`: runs conformance suites on models, without pytest."""

__all__ = ["conformance"]

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.options import Config, FailOn, LevelName, PrintJsonOption, TargetName
from gsgen.cli.output import echo_error, echo_text
from gsgen.contract.errors import ConfigInvalid, ModelUnreadable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gsgen.conformance.evidence import EvidenceDumps
    from gsgen.conformance.expected import ExpectedFailure
    from gsgen.conformance.summary import Entry
    from gsgen.contract.validation.settings import Settings


class Format(StrEnum):
    """Output formats of the command `gsgen conformance`."""

    TEXT = "text"
    JSON = "json"


def conformance(
    models: Annotated[
        list[Path], typer.Argument(help="ONNX files, folders and globs.", show_default=False)
    ],
    suite: Annotated[
        list[str] | None,
        typer.Option(help="Only this suite: basic, camera, time, avatar, …; repeatable."),
    ] = None,
    target: TargetName = None,
    level: LevelName = None,
    xfails: Annotated[
        Path | None, typer.Option(help="TOML file of expected failures, strict both ways.")
    ] = None,
    fail_on: FailOn = None,
    config: Config = None,
    dump: Annotated[
        Path | None, typer.Option(help="Folder for inputs and outputs of failing probes (.npz).")
    ] = None,
    format: Annotated[Format, typer.Option(help="How to print the result.")] = Format.TEXT,
    as_json: PrintJsonOption = False,
) -> None:
    """Run conformance suites on each MODEL, and print a command that reproduces each failure.

    Exits 0 if all pass, 1 if not, 2 for wrong options, 3 if a rule crashed, 4 if no model.
    """
    from gsgen.conformance.evidence import EvidenceDumps
    from gsgen.conformance.expected import read_expected
    from gsgen.conformance.suite import find_suite
    from gsgen.conformance.summary import exit_code
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings
    from gsgen.contract.validator import expand_paths

    files = expand_paths(models)
    registry = installed_rules()
    settings = make_settings(registry, level=level, target=target, fail_on=fail_on, config=config)
    suites = [find_suite(name).name for name in suite or ()]
    expected = read_expected(xfails, registry) if xfails else ()
    evidence_dumps = EvidenceDumps(dump) if dump else None
    entries = [
        _test_generators(model, settings, suites, expected, evidence_dumps) for model in files
    ]
    _print(entries, Format.JSON if as_json else format)
    _refuse_unused_suites(entries, settings, suites)
    _refuse_unmatched_entries(entries, settings, expected)
    raise typer.Exit(exit_code(entries))


def _test_generators(
    model: Path,
    settings: "Settings",
    suites: "list[str]",
    expected: "Sequence[ExpectedFailure]",
    evidence_dumps: "EvidenceDumps | None",
) -> "Entry":
    from gsgen.cli.progress import progress
    from gsgen.conformance.run import run_model
    from gsgen.contract.validation.report import Unreadable

    try:
        return run_model(
            model,
            settings,
            suites=suites,
            expected=expected,
            dumps=evidence_dumps,
            progress=progress,
        )
    except ModelUnreadable as error:
        return Unreadable(str(model), error)


def _print(entries: "list[Entry]", format: Format) -> None:
    from gsgen.cli.output import show
    from gsgen.cli.progress import clear
    from gsgen.conformance.summary import lines_of, to_json
    from gsgen.contract.validation.report import Unreadable

    clear()
    for entry in entries:
        if isinstance(entry, Unreadable):
            echo_error(entry.error)
        elif format is Format.TEXT:
            show(lines_of(entry))
    if format is Format.JSON:
        echo_text(to_json(entries))


def _refuse_unused_suites(
    entries: "list[Entry]", settings: "Settings", suites: "list[str]"
) -> None:
    """Raise if a requested suite applies to no tested model: nothing was tested by it."""
    from gsgen.conformance.run import ModelRun, suites_of

    model_runs = [entry for entry in entries if isinstance(entry, ModelRun)]
    tested_suites = {name for run in model_runs for name in run.suites}
    unused_suites = [name for name in suites if name not in tested_suites]
    if not model_runs or not unused_suites:
        return
    known_suites = dict.fromkeys(
        name for run in model_runs for name in suites_of(Path(run.report.path), settings)
    )
    message = f"the suite {unused_suites[0]!r} applies to no tested model"
    raise ConfigInvalid(
        message, where="--suite", hint=f"Those that apply: {', '.join(known_suites)}."
    )


def _refuse_unmatched_entries(
    entries: "list[Entry]", settings: "Settings", expected: "Sequence[ExpectedFailure]"
) -> None:
    """Raise if an expected failure matches no tested rule, after the results are printed."""
    from gsgen.conformance.expected import unmatched_entries
    from gsgen.conformance.run import ModelRun, suites_of

    tested_suites = {
        Path(entry.report.path): [
            rule.id
            for rules in suites_of(Path(entry.report.path), settings).values()
            for rule in rules
        ]
        for entry in entries
        if isinstance(entry, ModelRun)
    }
    for entry in unmatched_entries(expected, tested_suites):
        message = "matches no rule of any tested model"
        raise ConfigInvalid(message, where=str(entry), hint="Remove or correct the entry.")

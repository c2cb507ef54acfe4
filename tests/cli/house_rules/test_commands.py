from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest
import typer
from typer.testing import CliRunner

from gsgen.cli.app import build
from gsgen.contract._extensions import Command


@dataclass(frozen=True, slots=True)
class IncompleteCommand(Command):
    absent: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        return self.absent


def command(value: str, missing: tuple[str, ...] = ()) -> Command:
    return IncompleteCommand("thing", EntryPoint("thing", value, "gsgen.commands"), missing)


def test_a_command_that_cannot_be_imported_spoils_only_itself() -> None:
    app = build([command("no_such_module:thing")])
    listed = CliRunner().invoke(app, ["--help"])
    assert listed.exit_code == 0
    assert "Broken: ModuleNotFoundError" in listed.output
    ran = CliRunner().invoke(app, ["thing", "any", "words"])
    assert ran.exit_code == 3
    assert "`gsgen thing` (no_such_module:thing) cannot be loaded" in ran.output


@pytest.mark.parametrize("words", [[], ["a"], ["--option", "b"], ["a", "--flag"]])
def test_a_command_without_its_extra_takes_any_words_and_says_what_it_needs(
    words: list[str],
) -> None:
    ran = CliRunner().invoke(build([command("x:y [extra]", ("acme",))]), ["thing", *words])
    assert ran.exit_code == 2
    assert "needs acme, which is not installed: pip install 'gsgen[extra]'" in ran.output


def test_a_command_may_be_a_whole_app() -> None:
    assert isinstance(command("gsgen.sdk.commands.export:app").load(), typer.Typer)

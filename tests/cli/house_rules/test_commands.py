from importlib.metadata import EntryPoint

import pytest
import typer
from typer.testing import CliRunner

from gsgen.cli import command_group, command_table
from gsgen.cli.command_group import build
from gsgen.cli.command_table import PANELS, Command, panels
from gsgen.cli.root_help import missing_note
from gsgen.contract import _entry_points
from gsgen.contract._entry_points import Extension, ExtensionUnusable

BUILT_IN_COMMANDS = [command for commands in PANELS.values() for command in commands]


def command(name: str, value: str) -> Command:
    return Command(name, "It acts.", Extension(name, EntryPoint(name, value, "gsgen.commands")))


def raised_by(
    command: Command, words: list[str], monkeypatch: pytest.MonkeyPatch
) -> ExtensionUnusable:
    monkeypatch.setattr(command_group, "find_command", lambda _: command)
    completed = CliRunner().invoke(build(), [command.name, *words])
    assert isinstance(completed.exception, ExtensionUnusable)
    return completed.exception


def test_a_command_that_cannot_be_imported_says_so_when_it_is_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    error = raised_by(command("thing", "no_such_module:thing"), ["any", "words"], monkeypatch)
    assert error.exit_code == 3
    assert "`thing` (no_such_module:thing) cannot be loaded: ModuleNotFoundError" in str(error)


@pytest.mark.parametrize("words", [[], ["a"], ["--option", "b"], ["a", "--flag"]])
def test_a_command_without_its_extra_takes_any_words_and_says_what_it_needs(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        _entry_points, "_requirements", lambda _: ("acme; extra == 'fancy'", "numpy>=2")
    )
    error = raised_by(command("thing", "x:y [fancy]"), words, monkeypatch)
    assert error.exit_code == 2
    assert "needs acme, which is not installed: pip install 'gsgen[fancy]'" in str(error)


def test_commands_without_their_extra_are_listed_by_what_installs_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_entry_points, "_is_installed", lambda name: name not in ("torch", "wgpu"))
    unavailable_commands = [
        command("validate", "x"),
        command("fix", "x [sdk]"),
        command("rewrite", "x [sdk]"),
    ]
    unavailable_commands.append(command("render", "x [runtime]"))
    assert missing_note(unavailable_commands) == (
        "Not installed here: fix, rewrite: pip install 'gsgen[sdk]'; "
        "render: pip install 'gsgen[runtime]'"
    )
    assert missing_note(unavailable_commands[:1]) == ""


@pytest.mark.parametrize("entry", BUILT_IN_COMMANDS, ids=lambda entry: entry.name)
def test_a_summary_is_the_first_paragraph_of_the_help_of_its_command(entry: Command) -> None:
    loaded = entry.code.point.load()
    text = loaded.info.help if isinstance(loaded, typer.Typer) else loaded.__doc__
    assert " ".join(text.partition("\n\n")[0].split()) == entry.summary


def test_commands_of_other_packages_come_last_and_replace_none_of_ours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    others = {name: command(name, "x").code for name in ("acme", "validate")}
    monkeypatch.setattr(command_table, "find_extensions", lambda _: others)
    *ours, other = panels()
    assert (ours, other) == (list(PANELS), "Other commands")
    assert [entry.name for entry in panels()[other]] == ["acme"]
    assert command_table.find_command("validate") in BUILT_IN_COMMANDS

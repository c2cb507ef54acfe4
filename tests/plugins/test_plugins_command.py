import json
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.cli.commands.exporting import plugins as command
from gsgen.contract import _entry_points
from gsgen.contract._entry_points import Extension
from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.fields.roles import ROLES

EXPECTED_NAMES = {"deformable-3dgs", "hexplane-4dgs", "octree-gs", "scaffold-gs", "static"}


def list_plugins(*words: str) -> list[dict]:
    completed = CliRunner().invoke(build(), ["plugins", "--json", *words])
    assert completed.exit_code == 0, completed.output
    facts: list[dict] = json.loads(completed.output)
    return facts


def test_every_plugin_says_what_it_reads_and_what_its_models_take() -> None:
    plugins = {facts["name"]: facts for facts in list_plugins()}
    assert set(plugins) >= EXPECTED_NAMES
    for plugin in plugins.values():
        assert plugin["usable"]
        assert plugin["summary"]
        assert plugin["reads"].startswith("Reads ")
        assert set(plugin["inputs"]) <= set(ROLES)
        assert plugin["package"].startswith("gsgen ")
    assert plugins["hexplane-4dgs"]["inputs"] == ["time"]


def test_command_lists_the_named_plugins() -> None:
    assert [plugin["name"] for plugin in list_plugins("static", "octree-gs")] == [
        "octree-gs",
        "static",
    ]
    with pytest.raises(UnknownName, match="unknown plugin 'octree'"):
        command.plugins(["octree"])


def test_plugin_lacking_a_dependency_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    point = EntryPoint("ghost", "no.such.module:PLUGIN [sdk]", "gsgen.generators")
    monkeypatch.setattr(command, "find_plugins", lambda: {"ghost": Extension("ghost", point)})
    monkeypatch.setattr(_entry_points, "_requirements", lambda _: ("x; extra == 'sdk'",))
    command.plugins()
    assert "lacks x: pip install" in capsys.readouterr().out


def test_listing_imports_no_torch() -> None:
    script = (
        "import sys; from gsgen.cli.commands.exporting.plugins import plugins; plugins(None, True); "
        "sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)

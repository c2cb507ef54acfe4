import json
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest
from typer.testing import CliRunner

from gsgen.cli.app import build
from gsgen.contract import _extensions
from gsgen.contract._extensions import Command, find_commands
from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.sdk.commands import plugins as command

EXPECTED_NAMES = {"deformable-3dgs", "hexplane-4dgs", "octree-gs", "scaffold-gs", "static"}


def listed(*words: str) -> list[dict]:
    app = build([find_commands()["plugins"]])
    ran = CliRunner().invoke(app, ["plugins", "--json", *words])
    assert ran.exit_code == 0, ran.output
    facts: list[dict] = json.loads(ran.output)
    return facts


def test_every_plugin_says_what_it_reads_and_what_its_models_take() -> None:
    plugins = {facts["name"]: facts for facts in listed()}
    assert set(plugins) >= EXPECTED_NAMES
    for plugin in plugins.values():
        assert plugin["usable"]
        assert plugin["summary"]
        assert plugin["reads"].startswith("Reads ")
        assert set(plugin["inputs"]) <= set(ROLES)
        assert plugin["package"].startswith("gsgen ")
    assert plugins["hexplane-4dgs"]["inputs"] == ["time"]


def test_some_can_be_asked_for() -> None:
    assert [plugin["name"] for plugin in listed("static", "octree-gs")] == ["octree-gs", "static"]
    with pytest.raises(UnknownName, match="unknown plugin 'octree'"):
        command.plugins(["octree"])


def test_one_that_lacks_something_says_what(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    point = EntryPoint("ghost", "no.such.module:PLUGIN", "gsgen.generators")
    monkeypatch.setattr(command, "find_plugins", lambda: {"ghost": Command("ghost", point)})
    monkeypatch.setattr(_extensions, "_missing", lambda _: ("x",))
    command.plugins()
    assert "lacks x: pip install" in capsys.readouterr().out


def test_listing_imports_no_torch() -> None:
    script = (
        "import sys; from gsgen.sdk.commands.plugins import plugins; plugins(None, True); "
        "sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)

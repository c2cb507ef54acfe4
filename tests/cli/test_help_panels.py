"""`gsgen --help`: commands in panels, and the lines that install those that are missing."""

from types import SimpleNamespace
from typing import Any

from gsgen.cli.app import _epilog
from gsgen.cli.help_panels import PANELS, panel_of, panel_order


def command(name: str, remedy: str, *missing: str) -> Any:
    return SimpleNamespace(name=name, remedy=remedy, missing=missing)


def test_missing_commands_are_listed_by_their_remedy() -> None:
    commands = [
        command("validate", "none"),
        command("fix", "pip install 'gsgen[sdk]'", "torch"),
        command("render", "pip install 'gsgen[runtime]'", "wgpu"),
        command("rewrite", "pip install 'gsgen[sdk]'", "torch", "onnx-ir"),
    ]
    assert _epilog(commands) == (
        r"Not installed here: fix, rewrite: pip install 'gsgen\[sdk]'; "
        r"render: pip install 'gsgen\[runtime]'"
    )
    assert _epilog(commands[:1]) is None


def test_commands_stand_in_the_order_of_their_panels_and_others_come_last() -> None:
    listed = [name for names in PANELS.values() for name in names]
    commands = sorted(["zebra", *listed, "acme"], key=panel_order)
    assert commands == [*listed, "acme", "zebra"]
    assert panel_of("acme") == panel_of("zebra") != panel_of(listed[-1])

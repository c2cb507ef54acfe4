"""The end of `gsgen --help`: commands that are not installed, by the line that installs them."""

from types import SimpleNamespace
from typing import Any

from gsgen.cli.app import _epilog


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

"""The picture of the rooms is drawn from the imports, and shows that they point downwards."""

import importlib.util
import sys
from types import ModuleType

import pytest

from support.commands import ROOT


@pytest.fixture(scope="module")
def script() -> ModuleType:
    sys.path.insert(0, str(ROOT / "scripts"))
    path = ROOT / "scripts" / "draw_rooms.py"
    spec = importlib.util.spec_from_file_location("draw_rooms", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_picture_is_current(script: ModuleType) -> None:
    command_hint = "run: .venv/bin/python scripts/draw_rooms.py"
    assert script.PICTURE.read_text("utf-8") == script.drawn(), command_hint


def test_imports_point_downwards(script: ModuleType) -> None:
    names = [room.name for room in script.drawn_rooms()]
    assert len(script.arcs(names)) > len(names)
    assert script.imports_up() == []
    assert script.circles() == []


def test_no_room_calls_a_higher_one_by_name(script: ModuleType) -> None:
    """Calls through the groups that third parties use may point up: `validate` finds all rules."""
    assert script.calls_up(public=False) == []


def test_a_call_through_entry_points_is_noticed(script: ModuleType) -> None:
    called = {(caller, word) for caller, _, word in script.called_units()}
    assert ("gsgen.sdk.plugins", "gsgen.generators") in called


def test_every_room_states_its_question(script: ModuleType) -> None:
    for room in script.drawn_rooms():
        assert len(room.question) > 15, room.name
        assert room.question[-1] in "?.", room.name

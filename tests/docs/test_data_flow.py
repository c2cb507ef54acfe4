"""The picture of a frame's stages is drawn anew, and names the stages that there are."""

import importlib.util
import inspect
import re
import sys
from types import ModuleType

import pytest

from gsgen.runtime.renderer import frame_plan, tile_lists, weighted_plan
from support.commands import ROOT


@pytest.fixture(scope="module")
def script() -> ModuleType:
    path = ROOT / "scripts" / "draw_data_flow.py"
    spec = importlib.util.spec_from_file_location("draw_data_flow", path)
    assert spec is not None
    assert spec.loader is not None
    result = importlib.util.module_from_spec(spec)
    sys.modules["draw_data_flow"] = result  # dataclasses look their module up
    spec.loader.exec_module(result)
    return result


def stages() -> set[str]:
    """Return the names of all stages that plans record."""
    text = "".join(inspect.getsource(part) for part in (frame_plan, tile_lists, weighted_plan))
    named = re.findall(r'stages\["([\w ]+)"(?:\]| if )', text)
    started = re.findall(
        r'^ *(?:stages = \{|return \{)?"([\w ]+)": (?:self\._project|self\.slabs|recorded_stages\})',
        text,
        re.MULTILINE,
    )
    return {*named, *started}


def test_data_flow_picture_is_current(script: ModuleType) -> None:
    command_hint = "run: .venv/bin/python scripts/draw_data_flow.py"
    assert script.PICTURE.read_text("utf-8") == script.drawn(), command_hint


def test_picture_has_exactly_the_stages_of_the_code(script: ModuleType) -> None:
    assert len(stages()) >= 14
    boxes = [box for box in script.BOXES if box.fill == script.STAGE]
    words = {word.strip(",") for box in boxes for word in f"{box.name} {box.below}".split()}
    assert {name.partition(" ")[0] for name in stages()} <= words
    assert {box.name for box in boxes} <= stages()

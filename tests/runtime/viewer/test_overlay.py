"""Panels over the picture: where they are drawn."""

import pytest

from gsgen.runtime.viewer.overlay import Overlay


@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_messages_and_help_are_centred(ratio: float) -> None:
    overlay = Overlay()
    width, height = 1400, 1000
    (message,) = overlay.panels((width, height), ratio, slider=None, message="the model ended")
    overlay.shows_help = True
    (help,) = overlay.panels((width, height), ratio, slider=None, message="")
    for panel, fraction in ((message, 0.3), (help, 0.5)):
        rows, columns, _ = panel.picture.shape
        assert 0 < columns < width
        assert panel.corner == ((width - columns) // 2, max(0, round(fraction * (height - rows))))


def test_a_panel_wider_than_the_window_begins_at_its_left_edge() -> None:
    (panel,) = Overlay().panels((100, 400), 1.0, slider=None, message="a word and more, " * 9)
    assert panel.picture.shape[1] > 100
    assert panel.corner[0] == 0

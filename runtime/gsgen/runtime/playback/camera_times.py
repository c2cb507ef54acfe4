"""Turns the times of a camera file into values of the models' time inputs."""

__all__ = ["camera_time_tracks"]

from collections.abc import Sequence

import numpy as np

from gsgen.runtime.playback.camera_options import Viewpoint
from gsgen.runtime.playback.input_tracks import Track
from gsgen.runtime.playback.timeline import AnimatedInputs


def camera_time_tracks(
    view: Viewpoint,
    models: Sequence[AnimatedInputs],
    tracks: Sequence[Track] = (),
    time: float | None = None,
) -> tuple[list[Track], tuple[str, ...]]:
    """Return the tracks of a camera file's times, and notes on times that are not used.

    ``tracks`` and ``time`` of the caller take precedence: with a time among them, those of the
    camera file are left out.
    """
    if not view.times or time is not None:
        return [], ()
    if not any(spec.role == "time" for model in models for spec in model.inputs):
        return [], ("not used: the times of the cameras, because no scene has a time input",)
    set_roles = {
        spec.role for track in tracks for model in models for spec in model.named(track.input_name)
    }
    if "time" in set_roles:
        return [], ()
    return [Track("time", np.array(view.times), "--camera")], ()

"""What pictures of panoramas tell viewers of 360° pictures."""

import re

import pytest

from gsgen.runtime.media.pictures import gpano
from gsgen.runtime.scene.camera import Camera

ORIGIN = (0.0, 0.0, 0.0)


def pixels(camera: Camera) -> dict[str, int]:
    """Return the sizes that are told, by name."""
    packet = gpano(camera)
    assert packet is not None
    assert b'GPano:ProjectionType="equirectangular"' in packet
    matches = re.findall(rb'GPano:(\w+)Pixels="(-?\d+)"', packet)
    return {name.decode(): int(value) for name, value in matches}


def test_full_panorama_covers_the_sphere() -> None:
    assert pixels(Camera.panorama(ORIGIN, width=400)) == {
        "FullPanoWidth": 400,
        "FullPanoHeight": 200,
        "CroppedAreaImageWidth": 400,
        "CroppedAreaImageHeight": 200,
        "CroppedAreaLeft": 0,
        "CroppedAreaTop": 0,
    }


def test_partial_panorama_has_its_crop_offset() -> None:
    part = Camera.panorama(ORIGIN, width=90, longitudes=(-45, 45), latitudes=(-10, 60))
    assert pixels(part) == {
        "FullPanoWidth": 360,
        "FullPanoHeight": 180,
        "CroppedAreaImageWidth": 90,
        "CroppedAreaImageHeight": 70,
        "CroppedAreaLeft": 135,
        "CroppedAreaTop": 30,
    }


@pytest.mark.parametrize(
    "camera",
    [
        Camera.look_at(ORIGIN, (0, 0, 1)),
        Camera.look_at(ORIGIN, (0, 0, 1)).flattened(2.0),
        Camera.panorama(ORIGIN, width=90, longitudes=(135, 225), latitudes=(-45, 45)),
        Camera.panorama(ORIGIN, width=400, height=300),
    ],
    ids=["pinhole", "orthographic", "across the seam", "stretched"],
)
def test_inexpressible_panoramas_have_no_metadata(camera: Camera) -> None:
    assert gpano(camera) is None

"""GPano: XMP metadata that marks an image file as a panorama for 360° viewers."""

__all__ = ["gpano"]

import math
from typing import Final

from gsgen.runtime.scene.camera import Camera

_PACKET: Final = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
    "{}/></rdf:RDF></x:xmpmeta>"
)


def gpano(camera: Camera) -> bytes | None:
    """Return the XMP packet of a panorama camera, in the terms of Google's Photo Sphere.

    The terms place the picture in the full sphere, whose middle is the camera's direction. The
    result is None for other cameras, and where the terms do not suffice: for a sphere that is not
    twice as wide as high, and for a picture across its seam.
    """
    width, height = round(camera.period), round(math.pi * camera.fy)
    left = round(width / 2 - camera.cx)
    top = round(height / 2 - camera.cy)
    is_inside = left >= 0 and top >= 0
    is_inside &= left + camera.width <= width and top + camera.height <= height
    if camera.kind != "panorama" or width != 2 * height or not is_inside:
        return None
    terms = {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": camera.width,
        "CroppedAreaImageHeightPixels": camera.height,
        "CroppedAreaLeftPixels": left,
        "CroppedAreaTopPixels": top,
    }
    attributes = " ".join(f'GPano:{name}="{value}"' for name, value in terms.items())
    return _PACKET.format(attributes).encode()

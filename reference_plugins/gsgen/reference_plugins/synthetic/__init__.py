"""Which synthetic scenes and checkpoints can be written, and what do their writers share?

The writers of a family are in its folder; this package offers them all. They need torch, so they
are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gsgen.reference_plugins.anchors.synthetic_anchors import (
        AnchorOptions,
        write_duplex,
        write_octree,
        write_scaffold,
    )
    from gsgen.reference_plugins.bodies.synthetic_body import PersonOptions, write_body
    from gsgen.reference_plugins.bodies.synthetic_motion import write_motion
    from gsgen.reference_plugins.deformation.synthetic_deformations import (
        HexPlaneOptions,
        write_deformable,
        write_hexplane,
    )
    from gsgen.reference_plugins.images.synthetic_difix import write_difix
    from gsgen.reference_plugins.images.synthetic_images import write_denoiser, write_stylise
    from gsgen.reference_plugins.people.synthetic_people import write_gauhuman, write_lhm, write_r3
    from gsgen.reference_plugins.synthetic.knot import torus_knot

__all__ = [
    "AnchorOptions", "HexPlaneOptions", "PersonOptions", "torus_knot", "write_body",
    "write_deformable", "write_denoiser", "write_difix", "write_duplex", "write_gauhuman",
    "write_hexplane", "write_lhm", "write_motion", "write_octree", "write_r3", "write_scaffold",
    "write_stylise",
]  # fmt: skip

_MODULES = {
    name: module
    for module, names in {
        "anchors.synthetic_anchors": "AnchorOptions write_duplex write_octree write_scaffold",
        "bodies.synthetic_body": "PersonOptions write_body",
        "bodies.synthetic_motion": "write_motion",
        "deformation.synthetic_deformations": "HexPlaneOptions write_deformable write_hexplane",
        "images.synthetic_difix": "write_difix",
        "images.synthetic_images": "write_denoiser write_stylise",
        "people.synthetic_people": "write_gauhuman write_lhm write_r3",
        "synthetic.knot": "torus_knot",
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"gsgen.reference_plugins.{_MODULES[name]}")
    value: object = getattr(module, name)
    globals()[name] = value
    return value

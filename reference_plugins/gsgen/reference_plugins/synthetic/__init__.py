"""Scenes and checkpoints made from formulas, for tests, demos and pictures where no data is at hand.

The writers of checkpoints need torch; they are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import attributes

if TYPE_CHECKING:
    from gsgen.reference_plugins.synthetic.anchors import (
        AnchorOptions,
        write_duplex,
        write_octree,
        write_scaffold,
    )
    from gsgen.reference_plugins.synthetic.body import PersonOptions, write_body
    from gsgen.reference_plugins.synthetic.enhancer import write_difix
    from gsgen.reference_plugins.synthetic.images import write_denoiser, write_stylise
    from gsgen.reference_plugins.synthetic.knot import torus_knot
    from gsgen.reference_plugins.synthetic.moving import (
        HexPlaneOptions,
        write_deformable,
        write_hexplane,
    )
    from gsgen.reference_plugins.synthetic.people import write_gauhuman, write_lhm, write_r3
    from gsgen.reference_plugins.synthetic.walk import write_motion

__all__ = [
    "AnchorOptions",
    "HexPlaneOptions",
    "PersonOptions",
    "torus_knot",
    "write_body",
    "write_deformable",
    "write_denoiser",
    "write_difix",
    "write_duplex",
    "write_gauhuman",
    "write_hexplane",
    "write_lhm",
    "write_motion",
    "write_octree",
    "write_r3",
    "write_scaffold",
    "write_stylise",
]

_HOME = {
    "AnchorOptions": "anchors",
    "HexPlaneOptions": "moving",
    "PersonOptions": "body",
    "torus_knot": "knot",
    "write_body": "body",
    "write_deformable": "moving",
    "write_denoiser": "images",
    "write_difix": "enhancer",
    "write_duplex": "anchors",
    "write_gauhuman": "people",
    "write_hexplane": "moving",
    "write_lhm": "people",
    "write_motion": "walk",
    "write_octree": "anchors",
    "write_r3": "people",
    "write_scaffold": "anchors",
    "write_stylise": "images",
}

__getattr__ = attributes(__name__, _HOME)

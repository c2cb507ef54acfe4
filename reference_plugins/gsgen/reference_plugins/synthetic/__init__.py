"""Scenes and checkpoints made from formulas, for tests, demos and pictures where no data is at hand.

The writers of checkpoints need torch; they are loaded when first used.
"""

from typing import TYPE_CHECKING

from gsgen.contract.lazy import attributes

if TYPE_CHECKING:
    from gsgen.reference_plugins.synthetic.anchors import (
        AnchorOptions,
        write_duplex,
        write_octree,
        write_scaffold,
    )
    from gsgen.reference_plugins.synthetic.knot import torus_knot
    from gsgen.reference_plugins.synthetic.moving import (
        HexPlaneOptions,
        write_deformable,
        write_hexplane,
    )

__all__ = [
    "AnchorOptions",
    "HexPlaneOptions",
    "torus_knot",
    "write_deformable",
    "write_duplex",
    "write_hexplane",
    "write_octree",
    "write_scaffold",
]

_HOME = {
    "AnchorOptions": "anchors",
    "HexPlaneOptions": "moving",
    "torus_knot": "knot",
    "write_deformable": "moving",
    "write_duplex": "anchors",
    "write_hexplane": "moving",
    "write_octree": "anchors",
    "write_scaffold": "anchors",
}

__getattr__ = attributes(__name__, _HOME)

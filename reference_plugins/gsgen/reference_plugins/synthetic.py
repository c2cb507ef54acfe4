"""Writes synthetic checkpoints of every family, to try an export without data.

The writers of a family are in its folder; this module offers them all. They need torch, so they
are imported on first use.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

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
        write_sc_gs,
    )
    from gsgen.reference_plugins.heads.synthetic_head import write_gaussian_avatar
    from gsgen.reference_plugins.images.synthetic_difix import write_difix
    from gsgen.reference_plugins.images.synthetic_images import write_denoiser, write_stylise
    from gsgen.reference_plugins.octree_anygs.synthetic_anygs import write_anygs
    from gsgen.reference_plugins.people.synthetic_people import write_gauhuman, write_lhm, write_r3
    from gsgen.reference_plugins.spacetime.synthetic_rotor import write_rotor
    from gsgen.reference_plugins.spacetime.synthetic_spacetime import write_spacetime
    from gsgen.reference_plugins.static.synthetic_surfels import write_surfels
    from gsgen.reference_plugins.writing.knot import torus_knot

__all__ = [
    "AnchorOptions", "HexPlaneOptions", "PersonOptions", "torus_knot", "write_anygs", "write_body",
    "write_deformable", "write_denoiser", "write_difix", "write_duplex", "write_gauhuman", "write_gaussian_avatar",
    "write_hexplane", "write_lhm", "write_motion", "write_octree", "write_r3", "write_rotor", "write_sc_gs", "write_scaffold",
    "write_spacetime", "write_stylise", "write_surfels",
]  # fmt: skip

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)

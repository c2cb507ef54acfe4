"""Writes synthetic checkpoints of every family, to try an export without data.

The writers of a family are in its folder; this module offers them all. They need torch, so they
are imported on first use.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

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
    from gsgen.reference_plugins.enhancers.synthetic_enhancers import write_enhancer
    from gsgen.reference_plugins.feed_forward.synthetic_feed_forward import (
        write_lgm,
        write_splatter_image,
    )
    from gsgen.reference_plugins.heads.synthetic_head import write_gaussian_avatar
    from gsgen.reference_plugins.images.synthetic_difix import write_difix
    from gsgen.reference_plugins.images.synthetic_images import write_denoiser, write_stylise
    from gsgen.reference_plugins.octree_anygs.synthetic_anygs import write_anygs
    from gsgen.reference_plugins.people.synthetic_people import (
        write_gart,
        write_gauhuman,
        write_lhm,
        write_r3,
    )
    from gsgen.reference_plugins.sequences.synthetic_sequence import moving_knot, write_sequence
    from gsgen.reference_plugins.spacetime.synthetic_ex4dgs import write_ex4dgs
    from gsgen.reference_plugins.spacetime.synthetic_rotor import write_rotor
    from gsgen.reference_plugins.spacetime.synthetic_spacetime import write_spacetime
    from gsgen.reference_plugins.static.synthetic_surfels import write_surfels
    from gsgen.reference_plugins.styles.synthetic_styles import (
        write_adain,
        write_anime_gan,
        write_fast_neural_style,
    )
    from gsgen.reference_plugins.writing.knot import torus_knot

__all__ = [
    "AnchorOptions", "HexPlaneOptions", "PersonOptions", "moving_knot", "torus_knot", "write_adain", "write_anime_gan", "write_anygs", "write_body",
    "write_deformable", "write_denoiser", "write_difix", "write_duplex", "write_enhancer", "write_ex4dgs", "write_fast_neural_style", "write_gart", "write_gauhuman", "write_gaussian_avatar",
    "write_hexplane", "write_lgm", "write_lhm", "write_motion", "write_octree", "write_r3", "write_rotor", "write_sc_gs", "write_scaffold",
    "write_sequence", "write_spacetime", "write_splatter_image", "write_stylise", "write_surfels",
]  # fmt: skip

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "AnchorOptions": "gsgen.reference_plugins.anchors.synthetic_anchors",
    "write_duplex": "gsgen.reference_plugins.anchors.synthetic_anchors",
    "write_octree": "gsgen.reference_plugins.anchors.synthetic_anchors",
    "write_scaffold": "gsgen.reference_plugins.anchors.synthetic_anchors",
    "PersonOptions": "gsgen.reference_plugins.bodies.synthetic_body",
    "write_body": "gsgen.reference_plugins.bodies.synthetic_body",
    "write_motion": "gsgen.reference_plugins.bodies.synthetic_motion",
    "HexPlaneOptions": "gsgen.reference_plugins.deformation.synthetic_deformations",
    "write_deformable": "gsgen.reference_plugins.deformation.synthetic_deformations",
    "write_hexplane": "gsgen.reference_plugins.deformation.synthetic_deformations",
    "write_sc_gs": "gsgen.reference_plugins.deformation.synthetic_deformations",
    "write_enhancer": "gsgen.reference_plugins.enhancers.synthetic_enhancers",
    "write_lgm": "gsgen.reference_plugins.feed_forward.synthetic_feed_forward",
    "write_splatter_image": "gsgen.reference_plugins.feed_forward.synthetic_feed_forward",
    "write_gaussian_avatar": "gsgen.reference_plugins.heads.synthetic_head",
    "write_difix": "gsgen.reference_plugins.images.synthetic_difix",
    "write_denoiser": "gsgen.reference_plugins.images.synthetic_images",
    "write_stylise": "gsgen.reference_plugins.images.synthetic_images",
    "write_anygs": "gsgen.reference_plugins.octree_anygs.synthetic_anygs",
    "write_gart": "gsgen.reference_plugins.people.synthetic_people",
    "write_gauhuman": "gsgen.reference_plugins.people.synthetic_people",
    "write_lhm": "gsgen.reference_plugins.people.synthetic_people",
    "write_r3": "gsgen.reference_plugins.people.synthetic_people",
    "moving_knot": "gsgen.reference_plugins.sequences.synthetic_sequence",
    "write_sequence": "gsgen.reference_plugins.sequences.synthetic_sequence",
    "write_ex4dgs": "gsgen.reference_plugins.spacetime.synthetic_ex4dgs",
    "write_rotor": "gsgen.reference_plugins.spacetime.synthetic_rotor",
    "write_spacetime": "gsgen.reference_plugins.spacetime.synthetic_spacetime",
    "write_surfels": "gsgen.reference_plugins.static.synthetic_surfels",
    "write_adain": "gsgen.reference_plugins.styles.synthetic_styles",
    "write_anime_gan": "gsgen.reference_plugins.styles.synthetic_styles",
    "write_fast_neural_style": "gsgen.reference_plugins.styles.synthetic_styles",
    "torus_knot": "gsgen.reference_plugins.writing.knot",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)

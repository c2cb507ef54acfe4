"""Small runs of every method: what writes one, and what reads it."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.anchors.anchor_checkpoint import read_anchors
from gsgen.reference_plugins.anchors.cell_checkpoint import read_cells
from gsgen.reference_plugins.deformation.deformation_checkpoint import read_deformation
from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
from gsgen.reference_plugins.deformation.sc_gs_checkpoint import read_sc_gs
from gsgen.reference_plugins.feed_forward.lgm_checkpoint import read_lgm
from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import read_splatter_image
from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import read_gaussian_avatars
from gsgen.reference_plugins.octree_anygs.anygs_checkpoint import read_anygs
from gsgen.reference_plugins.people.gart_checkpoint import read_gart
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman
from gsgen.reference_plugins.people.lhm_checkpoint import read_lhm
from gsgen.reference_plugins.people.r3_avatar_checkpoint import read_r3
from gsgen.reference_plugins.spacetime.ex4dgs_checkpoint import read_ex4dgs
from gsgen.reference_plugins.spacetime.rotor_checkpoint import read_rotor
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import read_spacetime
from gsgen.reference_plugins.static.surfels import read_surfels
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    PersonOptions,
    write_anygs,
    write_deformable,
    write_duplex,
    write_ex4dgs,
    write_gart,
    write_gauhuman,
    write_gaussian_avatar,
    write_hexplane,
    write_lgm,
    write_lhm,
    write_octree,
    write_r3,
    write_rotor,
    write_sc_gs,
    write_scaffold,
    write_spacetime,
    write_splatter_image,
    write_surfels,
)

FEW = AnchorOptions(anchors=5)
UNITED = AnchorOptions(anchors=6, is_single_file=True)
PERSON = PersonOptions(count=4, nets=True)

METHODS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Any]]] = {
    "scaffold-gs": (lambda f: write_scaffold(f, FEW), read_anchors),
    "octree-gs": (lambda f: write_octree(f, UNITED), partial(read_anchors, octree=True)),
    "duplex-gs": (lambda f: write_duplex(f, UNITED), read_cells),
    "octree-anygs": (lambda f: write_anygs(f, FEW), read_anygs),
    "2dgs": (lambda f: write_surfels(f, count=4), read_surfels),
    "hexplane-4dgs": (lambda f: write_hexplane(f, HexPlaneOptions(count=4)), read_hexplanes),
    "deformable-3dgs": (lambda f: write_deformable(f, count=4), read_deformation),
    "gaussian-avatars": (lambda f: write_gaussian_avatar(f, count=4), read_gaussian_avatars),
    "sc-gs": (lambda f: write_sc_gs(f, count=4), read_sc_gs),
    "rotor-4dgs": (lambda f: write_rotor(f, count=4), read_rotor),
    "ex4dgs": (lambda f: write_ex4dgs(f, count=4), read_ex4dgs),
    "spacetime-gaussians": (lambda f: write_spacetime(f, count=4, full=True), read_spacetime),
    "gart": (lambda f: write_gart(f, PersonOptions(count=4, degree=1), resolution=4), read_gart),
    "gauhuman": (lambda f: write_gauhuman(f, PERSON), read_gauhuman),
    "lhm": (lambda f: write_lhm(f, PERSON), read_lhm),
    "r3-avatar": (lambda f: write_r3(f, PERSON), read_r3),
    "splatter-image": (lambda f: write_splatter_image(f, side=16, width=4), read_splatter_image),
    "lgm": (lambda f: write_lgm(f, down=(32, 32), up=(32,)), read_lgm),
}  # fmt: skip

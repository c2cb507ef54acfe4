"""How many bytes of a checkpoint a model cannot do without, family by family, in float32.

Counted from the checkpoint, not from the generator: what a plugin makes of the tensors does not
count, nor what no frame depends on. Of a body model only the vertices count that Gaussians hang on.
"""

from collections.abc import Iterable
from dataclasses import fields

import numpy as np
from torch import Tensor, nn

from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCheckpoint, Mlp
from gsgen.reference_plugins.anchors.cell_checkpoint import CellCheckpoint
from gsgen.reference_plugins.bodies import rest_pose
from gsgen.reference_plugins.bodies.body_models import Body
from gsgen.reference_plugins.bodies.pose_networks import PoseNets
from gsgen.reference_plugins.deformation.deformation_checkpoint import DeformationCheckpoint
from gsgen.reference_plugins.deformation.hexplane_checkpoint import HexPlaneCheckpoint
from gsgen.reference_plugins.deformation.sc_gs_checkpoint import ScGsCheckpoint
from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import GaussianAvatarsCheckpoint
from gsgen.reference_plugins.loading.canonical import Canonical
from gsgen.reference_plugins.people.lhm import expression_dirs
from gsgen.reference_plugins.people.lhm_checkpoint import EXPRESSIONS, LHMCheckpoint
from gsgen.reference_plugins.people.r3_avatar_checkpoint import R3Checkpoint
from gsgen.reference_plugins.spacetime.rotor_checkpoint import RotorSplats
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import SpacetimeSplats

_TIME_PLANES = (2, 4, 5)


def _sum(tensors: Iterable[Tensor | None]) -> int:
    return 4 * sum(tensor.numel() for tensor in tensors if tensor is not None)


def _mlp(net: Mlp | None) -> int:
    parts = (net.hidden, net.hidden_bias, net.out, net.out_bias) if net else ()
    return _sum(parts)


def of_anchors(read: AnchorCheckpoint, *, turned: bool = False) -> int:
    """Scaffold-GS and Octree-GS; ``turned``: the published culling needs rotations."""
    cloud, nets = read.cloud, read.nets
    retained = [cloud.position, cloud.offset, cloud.feature, cloud.log_scale]
    retained += [cloud.rotation] if turned else []
    levels = [cloud.level, cloud.extra_level]
    heads = (nets.opacity, nets.covariance, nets.color, nets.feature_bank)
    return _sum([*retained, *levels, nets.embedding]) + sum(_mlp(net) for net in heads)


def of_cells(read: CellCheckpoint, *, visibility: bool) -> int:
    """Duplex-GS, whose cells have three scales and not six."""
    sizes = 4 * 3 * len(read.anchors.cloud)
    more = _sum([read.visibility]) if visibility else 0
    return of_anchors(read.anchors) - sizes + more


def _canonical(canonical: Canonical) -> int:
    return _sum(
        (
            *(canonical.position, canonical.rotation, canonical.log_scale),
            *(canonical.logit_opacity, canonical.sh),
        )
    )


def of_hexplane(read: HexPlaneCheckpoint) -> int:
    """4DGaussians: of planes of time only the half that time reaches."""
    nets, total = read.nets, _canonical(read.canonical)
    for six in nets.grids:
        for index, plane in enumerate(six):
            reachable_plane = (
                plane[:, (plane.shape[1] - 1) // 2 :] if index in _TIME_PLANES else plane
            )
            total += _sum([reachable_plane])
    layers = [*nets.feature, *(layer for pair in nets.heads.values() for layer in pair)]
    layers += nets.static or ()
    return total + _sum(tensor for layer in layers for tensor in layer) + _sum(nets.voxels or ())


def of_deformation(read: DeformationCheckpoint) -> int:
    """Deformable-3D-Gaussians."""
    net = read.net
    layers = [*net.layers, *net.warp, *(net.time or ()), net.rotation, net.scaling]
    return _canonical(read.canonical) + _sum(tensor for layer in layers for tensor in layer)


def _nets(nets: PoseNets | None) -> int:
    layers = (*nets.pose, *nets.weights) if nets else ()
    return _sum(tensor for layer in layers for tensor in layer)


def _vertices(body: Body, used: int, *, shape: bool) -> int:
    joints, shapes = body.joints, body.shape_dirs.shape[2] if shape else 0
    vertex_values = 9 * (joints - 1) * 3 + 3 * shapes + joints
    return 4 * (used * vertex_values + joints * 3 * (shapes + 1))


def of_gauhuman(canonical: Canonical, body: Body, nets: PoseNets | None) -> int:
    """GauHuman, its shape an input."""
    posed_points = rest_pose.posed_vertices(body, rest_pose.big_pose(body), np.zeros(0))
    used = np.unique(rest_pose.nearest(canonical.position.double().numpy(), posed_points))
    return _canonical(canonical) + _vertices(body, len(used), shape=True) + _nets(nets)


def of_lhm(read: LHMCheckpoint) -> int:
    """LHM: shape and place of the vertices, and the expressions of those that any moves."""
    used = np.unique(rest_pose.nearest(read.samples, read.body.template))
    moved = np.abs(expression_dirs(read, None)[used]).max(axis=(1, 2)) > 0
    vertex_values = _sum((read.position, read.rgb, read.opacity, read.scale, read.rotation))
    vertices = len(used) * (read.body.joints + 3) + int(moved.sum()) * 3 * EXPRESSIONS
    return vertex_values + 4 * (vertices + 3 * read.body.joints) + _sum([read.neutral])


def of_r3(read: R3Checkpoint, used: int) -> int:
    """R3-Avatar with ``used`` vertices; scale, turn and opacity are the decoder's."""
    layers = [*read.inner_indices, *read.heads.values()]
    total = _sum((read.canonical.position, read.canonical.sh))
    total += _sum(plane for six in read.grids for plane in six)
    total += _sum(tensor for layer in layers for tensor in layer)
    return total + _vertices(read.body, used, shape=True) + _nets(read.nets)


def of_module(module: nn.Module) -> int:
    """Return the bytes of a network of images, which is exported as it was trained."""
    return _sum((*module.parameters(), *module.buffers()))


def of_splats(splats: RotorSplats | SpacetimeSplats) -> int:
    """Rotor 4DGS and SpacetimeGaussians, whose every tensor has a part in each frame."""
    values = (getattr(splats, field.name) for field in fields(splats))
    return _sum(value for value in values if isinstance(value, Tensor))


def of_nodes(read: ScGsCheckpoint) -> int:
    """SC-GS: Gaussians with hyper coordinates, nodes, and the network of the nodes."""
    nodes, net = read.nodes, read.nodes.net
    layers = [*net.layers, *net.warp, *(net.time or ()), net.rotation, net.scaling]
    control = (nodes.position, nodes.hyper_features, nodes.log_radius, nodes.logit_weight)
    return (
        _canonical(read.canonical)
        + _sum([read.hyper_features.expand(len(read.canonical), -1), *control])
        + _sum(tensor for layer in layers for tensor in layer)
    )


def of_head(read: GaussianAvatarsCheckpoint) -> int:
    """GaussianAvatars: of FLAME, only the triangles that Gaussians are bound to."""
    body, triangles = read.body, np.unique(read.binding)
    vertices = len(np.unique(body.faces[triangles]))
    # Position, expressions, pose and skinning weights of a vertex; corners; the binding.
    numbers = vertices * (3 + 3 * read.expressions + 3 * body.pose_dirs.shape[2] + body.joints)
    return _canonical(read.canonical) + 4 * (numbers + 3 * len(triangles) + len(read.binding))

"""Reads checkpoints of GauHuman: a 3DGS PLY in the big pose and, if trained, two networks.

They contain neither the body model, which training reads from ``assets/``, nor poses, which come
from the data set.
"""

__all__ = ["GauHumanCheckpoint", "read_gauhuman"]

from dataclasses import dataclass, replace
from pathlib import Path

from gsgen.reference_plugins.bodies.body_models import (
    Body,
    joints_of_file,
    read_body,
    required_body,
)
from gsgen.reference_plugins.bodies.pose_networks import PoseNets, read_pose_nets
from gsgen.reference_plugins.loading.canonical import Canonical, read_canonical
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import load_state
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_run

JOINTS = {"smpl": 24, "smplx": 55}
# Number of shape coefficients in training. For SMPL-X these are ten, and ten more that the published
# code calls expressions, but takes from the same array.
SHAPE_COUNTS = {"smpl": 10, "smplx": 20}
_SMPL_GENDERS = ("neutral", "male", "female")
# Levels from a run up to the training code: output/DATA/NAME.
_LEVEL_COUNT = 3


@dataclass(frozen=True, slots=True)
class GauHumanCheckpoint:
    """A trained avatar of GauHuman, without poses."""

    run: TrainingRun
    canonical: Canonical  # the Gaussians in the big pose
    body: Body  # the body model
    nets: PoseNets | None  # networks that correct joints and weights; None if they were not trained

    def describe(self) -> str:
        """Describe a GauHuman checkpoint in one line: Gaussians, networks and body model."""
        nets = "pose and weight networks" if self.nets is not None else "no networks"
        return f"{self.run}, {self.canonical.describe()}, {nets}; {self.body.describe()}"


def read_gauhuman(
    folder: Path, iteration: int | None = None, body: Path | None = None
) -> GauHumanCheckpoint:
    """Read a checkpoint of GauHuman.

    Without ``body``, the body model is searched under ``assets`` in the run and in the folders
    above it.
    """
    run = open_run("gauhuman", folder, iteration)
    model = read_body_of(run.folder, run.cfg, body)
    path = run.folder / "mlp_ckpt" / f"iteration_{run.iteration}" / "ckpt.pth"
    has_motion_offsets = run.cfg.flag("motion_offset_flag", default=path.is_file())
    if not has_motion_offsets and path.is_file():
        message = f"motion_offset_flag is False, but {path} exists"
        raise CheckpointInvalid(message, where=str(run.cfg.path))
    nets = _read_pose_networks(path, model.joints) if has_motion_offsets else None
    canonical = read_canonical(run.files / "point_cloud.ply")
    return GauHumanCheckpoint(run, canonical, model, nets)


def read_body_of(folder: Path, cfg: CfgArgs, body: Path | None) -> Body:
    """Read the body model that a training run used, by its options."""
    kind = cfg.word("smpl_type", _body_kind(body))
    if kind not in JOINTS:
        hint = "The published code reads this kind of body, but its model has no branch for it."
        message = f"smpl_type is {kind!r}, expected {' or '.join(map(repr, JOINTS))}"
        raise CheckpointInvalid(message, where=str(cfg.path), hint=hint)
    gender = cfg.word("actor_gender", "neutral", _SMPL_GENDERS).upper()
    file = f"SMPL_{gender}.pkl" if kind == "smpl" else f"models/smplx/SMPLX_{gender}.npz"
    joints = JOINTS[kind]
    # Training reads assets from the folder of its code, and writes runs to output/NAME there.
    parent_folders = [folder, *folder.absolute().parents[:_LEVEL_COUNT]]
    candidates = {
        f"assets {level}": parent_folder / "assets" / file
        for level, parent_folder in enumerate(parent_folders)
    }
    path = required_body(body, candidates, joints)
    read = read_body(path, joints)
    return replace(read, shape_dirs=read.shape_dirs[:, :, : SHAPE_COUNTS[kind]])


def _body_kind(body: Path | None) -> str:
    """Return SMPL or SMPL-X by the number of joints in a body model file; SMPL without a file."""
    if body is None or not body.is_file():
        return "smpl"
    joints = joints_of_file(body)
    return next((kind for kind, known in JOINTS.items() if known == joints), "smpl")


def _read_pose_networks(path: Path, joints: int) -> PoseNets:
    state = load_state(path, "the networks that motion_offset_flag=True trains")
    parts = [state.get(name) for name in ("pose_decoder", "lweight_offset_decoder")]
    pose, weights = parts
    if not isinstance(pose, dict) or not isinstance(weights, dict):
        hint = "Expected the state dicts pose_decoder and lweight_offset_decoder."
        message = f"holds {', '.join(map(str, state))}"
        raise CheckpointInvalid(message, where=str(path), hint=hint)
    return read_pose_nets(path, pose, weights, joints)

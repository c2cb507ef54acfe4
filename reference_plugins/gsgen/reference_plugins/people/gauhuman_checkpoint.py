"""Checkpoints of GauHuman: a 3DGS PLY in the big pose and, where trained, two networks.

The body model is not part of them: training reads it from ``assets/``. Neither are poses, which
came from the data set.
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
from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import find_iteration, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method
from gsgen.reference_plugins.loading.states import load_state

JOINTS = {"smpl": 24, "smplx": 55}
# Shape coefficients that training knows: of SMPL-X's ten and as many more, which the published code
# means for expressions, but takes from the same array, whatever the file has there.
SHAPES = {"smpl": 10, "smplx": 20}
_GENDERS = ("neutral", "male", "female")
# How far above a run the code of training may be: output/DATA/NAME.
_LEVELS = 3


@dataclass(frozen=True, slots=True)
class GauHumanCheckpoint:
    """Everything that inference needs, but for poses.

    Attributes:
        folder: Of the training run.
        iteration: Which one.
        cfg: Its options.
        canonical: The Gaussians in the big pose.
        body: What they follow.
        nets: Networks that correct joints and weights, where they were trained.
    """

    folder: Path
    iteration: int
    cfg: CfgArgs
    canonical: Canonical
    body: Body
    nets: PoseNets | None

    def describe(self) -> str:
        """Say in one line what it holds."""
        nets = "pose and weight networks" if self.nets is not None else "no networks"
        return (
            f"{self.folder}: iteration {self.iteration}, {self.canonical.describe()}, "
            f"{nets}; {self.body.describe()}"
        )


def read_gauhuman(
    folder: Path, iteration: int | None = None, body: Path | None = None
) -> GauHumanCheckpoint:
    """Read a checkpoint of GauHuman.

    Args:
        folder: What training wrote, or what is in it of an iteration.
        iteration: The last where absent.
        body: The body model; looked for under ``assets``, in the run or a little above it, where
            absent.

    Raises:
        CheckpointInvalid: Something is missing, or does not fit the rest.
    """
    folder, iteration = within_run(folder, iteration)
    number, place = find_iteration(folder, iteration)
    refuse_other_method("gauhuman", folder, place)
    cfg = read_cfg_args(folder)
    model = read_body_of(folder, cfg, body)
    path = folder / "mlp_ckpt" / f"iteration_{number}" / "ckpt.pth"
    trained = cfg.flag("motion_offset_flag", default=path.is_file())
    if not trained and path.is_file():
        what = f"motion_offset_flag is False, but there is {path}"
        raise CheckpointInvalid(what, where=str(cfg.path))
    nets = _read_nets(path, model.joints) if trained else None
    canonical = read_canonical(place / "point_cloud.ply")
    return GauHumanCheckpoint(folder, number, cfg, canonical, model, nets)


def read_body_of(folder: Path, cfg: CfgArgs, body: Path | None) -> Body:
    """Return the body model that a training run used, by its options.

    Raises:
        CheckpointInvalid: It is missing or of another kind.
    """
    kind = cfg.word("smpl_type", _kind_of(body))
    if kind not in JOINTS:
        hint = "Only the published readers know it; the model that they feed has no such branch."
        what = f"smpl_type is {kind!r}, wanted {' or '.join(map(repr, JOINTS))}"
        raise CheckpointInvalid(what, where=str(cfg.path), hint=hint)
    gender = cfg.word("actor_gender", "neutral", _GENDERS).upper()
    file = f"SMPL_{gender}.pkl" if kind == "smpl" else f"models/smplx/SMPLX_{gender}.npz"
    joints = JOINTS[kind]
    # Training reads them from where its code is, and writes to output/NAME there.
    homes = [folder, *folder.absolute().parents[:_LEVELS]]
    places = {f"assets {level}": home / "assets" / file for level, home in enumerate(homes)}
    path = required_body(body, places, joints)
    read = read_body(path, joints)
    return replace(read, shape_dirs=read.shape_dirs[:, :, : SHAPES[kind]])


def _kind_of(body: Path | None) -> str:
    """Return which body a file is of, for a run without options; SMPL where there is no file."""
    if body is None or not body.is_file():
        return "smpl"
    joints = joints_of_file(body)
    return next((kind for kind, known in JOINTS.items() if known == joints), "smpl")


def _read_nets(path: Path, joints: int) -> PoseNets:
    state = load_state(path, "the networks that motion_offset_flag=True trains")
    parts = [state.get(name) for name in ("pose_decoder", "lweight_offset_decoder")]
    pose, weights = parts
    if not isinstance(pose, dict) or not isinstance(weights, dict):
        hint = "Wanted the state dicts pose_decoder and lweight_offset_decoder."
        what = f"holds {', '.join(map(str, state))}"
        raise CheckpointInvalid(what, where=str(path), hint=hint)
    return read_pose_nets(path, pose, weights, joints)

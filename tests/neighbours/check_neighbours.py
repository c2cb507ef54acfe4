"""Exchange splats and frames with gsplat, nerfstudio, viser and Rerun, and compare the values.

Runs in an environment that has these programs (`make neighbours`). Prints a line for each
exchange, and exits 1 if one changes a value by more than its bound.
"""

import ast
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module, util
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import gsplat
import numpy as np
import torch
import viser
from gsplat.cuda._torch_impl import _quat_scale_to_covar_preci, _spherical_harmonics
from rerun.chunk import RrdReader

from gsgen.conformance.fixtures import find
from gsgen.contract.layout import basis, covariance_upper
from gsgen.formats import Splats, open_splats, write_ply
from gsgen.sdk.binding import FrameSession

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "examples"))
import watch_in_viser  # noqa: E402

COUNT = 500
Check = tuple[str, float, float]
"""The exchange, the largest difference of a value, and the bound."""


def main() -> int:
    """Run all checks, and return the exit code."""
    with tempfile.TemporaryDirectory(prefix="gsgen-neighbours-") as name:
        folder = Path(name)
        checks = [*gsplat_files(folder), *gsplat_formulas(), *nerfstudio_files(folder)]
        checks += [*viser_scene(folder), *check_rerun_recording(folder)]
    for title, difference, bound in checks:
        print(f"{title}: largest difference {difference:.2g}; bound {bound:.2g}")
    return 0 if all(difference <= bound for _, difference, bound in checks) else 1


def random_splats() -> Splats:
    """Return splats of SH degree 3."""
    random = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    return Splats(
        position=normal(COUNT, 3),
        rotation=normal(COUNT, 4),
        log_scale=normal(COUNT, 3) - 3,
        logit_opacity=normal(COUNT),
        sh=normal(COUNT, 16, 3) * 0.2,
    )


def parameters(splats: Splats) -> dict[str, torch.Tensor]:
    """Return splats under the names of gsplat's trainer."""
    arrays = {
        "means": splats.position,
        "scales": splats.log_scale,
        "quats": splats.rotation,
        "opacities": splats.logit_opacity,
        "sh0": splats.sh[:, :1],
        "shN": splats.sh[:, 1:],
    }
    return {name: torch.from_numpy(np.ascontiguousarray(x)) for name, x in arrays.items()}


def gsplat_files(folder: Path) -> Iterator[Check]:
    """Read what gsplat's exporter and trainer write; let torch read what gsgen read of it."""
    splats = random_splats()
    tensors = parameters(splats)
    torch.save({"step": 29_999, "splats": tensors}, folder / "ckpt_29999_rank0.pt")
    yield (
        "gsplat: checkpoint of its trainer",
        _max_difference(open_splats(folder / "ckpt_29999_rank0.pt"), splats),
        0,
    )
    gsplat.export_splats(**tensors, format="ply", save_to=str(folder / "gsplat.ply"))
    yield (
        "gsplat: PLY of its exporter",
        _max_difference(open_splats(folder / "gsplat.ply"), splats),
        0,
    )
    # The compressed PLY quantises; rows are in another order, so that clouds are compared.
    gsplat.export_splats(
        **tensors, format="ply_compressed", save_to=str(folder / "c.compressed.ply")
    )
    again = open_splats(folder / "c.compressed.ply")
    span = np.ptp(splats.position, axis=0).max()
    distance = np.linalg.norm(again.position[:, None] - splats.position, axis=2).min(axis=1).max()
    yield "gsplat: compressed PLY, centres as a share of the scene", float(distance / span), 0.01
    gsplat.export_splats(**tensors, format="splat", save_to=str(folder / "gsplat.splat"))
    again = open_splats(folder / "gsplat.splat")
    distance = np.linalg.norm(again.position[:, None] - splats.position, axis=2).min(axis=1).max()
    yield "gsplat: .splat, centres", float(distance), 1e-6
    write_ply(folder / "back.ply", open_splats(folder / "gsplat.ply"))
    yield "gsplat: PLY there and back", _max_difference(open_splats(folder / "back.ply"), splats), 0


def _max_difference(first: Splats, second: Splats) -> float:
    names = ("position", "rotation", "log_scale", "logit_opacity", "sh")
    return max(float(np.abs(getattr(first, x) - getattr(second, x)).max()) for x in names)


def gsplat_formulas() -> Iterator[Check]:
    """Compare covariances and harmonics with gsplat's formulas in torch, in float64."""
    splats = random_splats()
    quaternions = torch.from_numpy(splats.rotation).double()
    scales = torch.from_numpy(splats.log_scale).double().exp()
    expected, _ = _quat_scale_to_covar_preci(quaternions, scales, compute_preci=False, triu=True)
    actual = covariance_upper(scales.numpy(), splats.rotation.astype(np.float64))
    yield "gsplat: covariance of a quaternion and scales", _largest(actual - expected.numpy()), 1e-9
    directions = np.random.default_rng(1).normal(size=(COUNT, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    harmonics = torch.from_numpy(splats.sh).double()
    colors = _spherical_harmonics(3, torch.from_numpy(directions), harmonics).numpy()
    own = np.einsum("nk,nkc->nc", basis(directions, 3), splats.sh.astype(np.float64))
    yield "gsplat: colours of SH degree 3", _largest(own - colors), 1e-6


def _largest(difference: np.ndarray) -> float:
    return float(np.abs(difference).max())


def nerfstudio_files(folder: Path) -> Iterator[Check]:
    """Read a checkpoint in splatfacto's layout, and the PLY that nerfstudio's exporter writes."""
    splats = random_splats()
    tensors = parameters(splats)
    tensors["opacities"] = tensors["opacities"][:, None]
    tensors["features_dc"] = tensors.pop("sh0")[:, 0]
    tensors["features_rest"] = tensors.pop("shN")
    pipeline = {f"_model.gauss_params.{name}": tensor for name, tensor in tensors.items()}
    torch.save({"step": 29_999, "pipeline": pipeline}, folder / "step-000029999.ckpt")
    again = open_splats(folder / "step-000029999.ckpt")
    yield "nerfstudio: checkpoint of splatfacto", _max_difference(again, splats), 0
    exporter = nerfstudio_exporter()
    model = exporter.SplatfactoModel()
    vars(model).update(tensors | {"config": SimpleNamespace(sh_degree=3)})
    model.shs_0, model.shs_rest = tensors["features_dc"], tensors["features_rest"]
    exporter.eval_setup = lambda *_, **__: (None, SimpleNamespace(model=model), None, None)
    exporter.ExportGaussianSplat(folder / "config.yml", folder).main()
    yield (
        "nerfstudio: PLY of ns-export",
        _max_difference(open_splats(folder / "splat.ply"), splats),
        0,
    )


def nerfstudio_exporter() -> Any:
    """Import nerfstudio's exporter; programs that it imports and that are not here are mocked.

    It pins gsplat 1.4 and viser 0.2, and imports Open3D and others before it writes a PLY.
    """
    spec = util.find_spec("nerfstudio.scripts")
    folder = next(iter(spec.submodule_search_locations or ())) if spec else ""
    tree = ast.parse((Path(folder) / "exporter.py").read_text("utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {getattr(node, "module", None) or node.names[0].name for node in imports}
    mocked = {name for name in names if name.startswith(("nerfstudio.", "open3d", "tyro"))}
    with patch.dict(sys.modules, {name: MagicMock() for name in mocked}):
        module = import_module("nerfstudio.scripts.exporter")
    module.SplatfactoModel = type("SplatfactoModel", (), {})
    return module


def viser_scene(folder: Path) -> Iterator[Check]:
    """Run the example, and read the Gaussians from the scene of viser's server."""
    model = str(find("drift").write(folder))
    server = viser.ViserServer(port=0, verbose=False)
    watch_in_viser.watch(model, server, seconds=0.5)
    with FrameSession(model) as session:
        expected = session.run({"time": 0.0}, copy=True).gaussians()
    handle = server.scene._handle_from_node_name["/generator"]
    centers = np.asarray(handle._impl.props.buffer)[:, :3].view(np.float32)
    server.stop()
    yield "viser: centres of the first frame", _largest(centers - expected.position), 0


def check_rerun_recording(folder: Path) -> Iterator[Check]:
    """Run the example as a program, read its recording, and compose Σ from scales and axes."""
    model = str(find("drift").write(folder))
    example = ROOT / "docs" / "examples" / "log_to_rerun.py"
    command = [sys.executable, str(example), model, "frames.rrd", "--frames", "3"]
    subprocess.run(command, cwd=folder, check=True)
    chunks = RrdReader(folder / "frames.rrd").stream().to_chunks()
    (frames,) = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/generator"]
    assert frames.num_rows == 3
    with FrameSession(model) as session:
        for row, time in enumerate((0.0, 0.5, 1.0)):
            expected = session.run({"time": time}).gaussians()
            centers, scales, quaternions = (
                np.array(frames.column(f"GaussianSplats3D:{name}")[row].as_py())
                for name in ("centers", "scales", "quaternions")
            )
            yield f"rerun: centres at time {time}", _largest(centers - expected.position), 0
            covariance = covariance_upper(scales, np.roll(quaternions, 1, axis=1))
            largest = _largest(expected.covariance)
            yield (
                f"rerun: covariances at time {time}",
                _largest(covariance - expected.covariance) / largest,
                1e-5,
            )


if __name__ == "__main__":
    sys.exit(main())

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.spacetime import spacetime_gaussians_plugin as plugin
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import read_spacetime
from gsgen.reference_plugins.spacetime.spacetime_gaussians import SpacetimeGaussians, color_range
from gsgen.reference_plugins.synthetic import write_spacetime
from gsgen.reference_plugins.writing.run_files import write_columns
from support.checkpoints.plugin_checks import assert_like, camera, eager
from support.checkpoints.spacetime_oracles import raw_columns, spacetime

MOMENTS = (0.0, 0.123, 0.5, 0.98, 1.0)


def moment(time: float) -> np.ndarray:
    return np.array([time], np.float32)


@pytest.mark.parametrize("time", MOMENTS)
@pytest.mark.parametrize("seed", range(3))
def test_the_lite_model_moves_as_the_paper_says(seed: int, time: float, tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path, count=41, seed=seed))
    generator = SpacetimeGaussians(read.splats)
    expected = spacetime(tmp_path, float(np.float32(time)))
    assert_like(*eager(generator, moment(time)), expected)


@pytest.mark.parametrize("seed", range(4))
def test_the_full_model_is_decoded_along_the_ray(seed: int, tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path, count=29, full=True, seed=seed))
    generator = SpacetimeGaussians(read.splats, read.decoder)
    view, time = camera(np.random.default_rng(seed)), 0.3 * seed
    expected = spacetime(tmp_path, float(np.float32(time)), view)
    assert_like(*eager(generator, moment(time), view), expected)


def test_a_splat_of_no_duration_shows_at_its_moment_alone(tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path, count=5))
    read.splats.log_duration[0], read.splats.temporal_centre[0] = -200.0, 0.5
    generator = SpacetimeGaussians(read.splats)
    full = float(torch.sigmoid(read.splats.logit_opacity[0]))
    for time, opacity in ((0.5, full), (0.25, 0.0)):
        rows, _ = eager(generator, moment(time))
        assert np.isfinite(rows).all()
        assert rows[0, 3] == pytest.approx(opacity)


def test_colours_beyond_black_and_white_are_declared(tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path, count=5))
    assert SpacetimeGaussians(read.splats).color_range is None
    read.splats.features[1] = torch.tensor([-0.21, 0.5, 1.37])
    assert SpacetimeGaussians(read.splats).color_range == (-0.3, 1.4)
    assert color_range(torch.tensor([[0.2, 0.5, 1.01]])) == (0.0, 1.1)


@pytest.mark.parametrize(
    ("function", "color"), [("sandwich", 0.8807971), ("sandwichnoact", 1.0), ("sandwichnoactss", 1)]
)
def test_the_activation_is_that_of_the_training(
    function: str, color: float, tmp_path: Path
) -> None:
    write_spacetime(tmp_path, count=3, full=True)
    cfg = tmp_path / "cfg_args"
    cfg.write_text(cfg.read_text().replace("'sandwich'", repr(function)))
    read = read_spacetime(tmp_path)
    read.splats.features[:] = torch.tensor([2.0, 2, 2, 0, 0, 0, 0, 0, 0])
    assert read.decoder is not None
    read.decoder.hidden.zero_()
    generator = SpacetimeGaussians(read.splats, read.decoder)
    _, colors = eager(generator, moment(0.1), np.eye(4, dtype=np.float32))
    np.testing.assert_allclose(colors, color, atol=1e-6)


def test_a_ply_of_any_name_is_read(tmp_path: Path) -> None:
    (cloud,) = write_spacetime(tmp_path / "run", count=7).rglob("*.ply")
    shutil.copy(cloud, tmp_path / "flames.ply")
    shutil.copy(cloud, tmp_path / "other.ply")
    first, two = (plugin.build(path) for path in (tmp_path / "flames.ply", cloud))
    assert first.producer == two.producer
    assert torch.equal(first.motion, two.motion)
    assert (first.inputs[0].frames, two.inputs[0].frames) == (None, 50)  # cfg_args has the duration


def test_full_model_is_refused_unless_approximation_is_requested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    full = write_spacetime(tmp_path / "full", count=3, full=True)
    with pytest.raises(NotInCheckpoint, match="decoded per pixel") as caught:
        plugin.build(full)
    assert "--decode per-splat" in caught.value.hint
    assert "--decode features" in caught.value.hint
    plugin.build(full, decode="per-splat")
    assert "warning: colours are approximate" in capsys.readouterr().err
    lite = write_spacetime(tmp_path / "lite", count=3)
    with pytest.raises(NotInCheckpoint, match="need no decoder"):
        plugin.build(lite, decode="per-splat")


def test_invalid_file_is_named(tmp_path: Path) -> None:
    full = write_spacetime(tmp_path / "full", count=3, full=True)
    (cloud,) = full.rglob("*.ply")
    columns = raw_columns(cloud)
    cloud.with_suffix(".pt").unlink()
    with pytest.raises(CheckpointInvalid, match="is missing: the decoder of the full model"):
        read_spacetime(full)
    write_columns(cloud, {name: columns[name] for name in columns if name != "omega_2"})
    with pytest.raises(CheckpointInvalid, match="omega_2 are missing"):
        read_spacetime(full)
    cfg = full / "cfg_args"
    cfg.write_text(cfg.read_text().replace("'sandwich'", "'ray'"))
    write_columns(cloud, columns)
    state = {"mlp1.weight": torch.zeros(6, 12, 1, 1), "mlp2.weight": torch.zeros(3, 6, 1, 1)}
    torch.save(state, cloud.with_suffix(".pt"))
    with pytest.raises(CheckpointInvalid, match="rgbfunction is 'ray', expected 'sandwich' or"):
        read_spacetime(full)

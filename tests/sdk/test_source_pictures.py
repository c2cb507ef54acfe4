"""Pictures of the eager module at export: level render sees what later changes the picture."""

from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.runtime.checks.eager_pictures import draw_source_frames
from gsgen.sdk import GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.source_pictures import SourcePictures
from support.commands import gsgen_here

RENDER = Settings(level=Level.RENDER)


class Ball(GaussianGenerator):
    """Gaussians on a sphere that moves with time; red on one side, blue on the other."""

    inputs = (inputs.time(range=(0, 1)),)
    family = "4d"

    def __init__(self) -> None:
        super().__init__()
        points = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
        points = points / points.norm(dim=1, keepdim=True)
        self.register_buffer("points", points)
        tints = torch.stack([points[:, 0], 0.2 * points[:, 1], -points[:, 0]], dim=1)
        self.register_buffer("tints", 0.5 + 0.4 * tints)

    def forward(self, time: torch.Tensor) -> Gaussians:
        ones = torch.ones_like(self.points)
        return Gaussians(
            position=self.points + 0.2 * time,
            opacity=0.9 * ones[:, 0],
            scale=0.12 * ones,
            rotation=torch.tensor([1.0, 0, 0, 0]) * torch.ones_like(self.points[:, :1]),
            rgb=self.tints,
        )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("pictured") / "ball.onnx"
    return export(Ball(), path, pictures=SourcePictures(2, draw_source_frames), vectors=0)


def test_pictures_of_the_module_are_declared_as_those_of_the_source(exported):
    manifest = loads(open_model(exported.path).manifest_text)
    images = manifest.reference_images
    assert [image.path for image in images] == ["ball-references/0.png", "ball-references/1.png"]
    assert {image.from_ for image in images} == {"source"}
    assert len({image.inputs for image in images}) == 2
    assert all((exported.path.parent / image.path).is_file() for image in images)
    assert exported.manifest.reference_images == images


def test_the_exported_model_draws_the_pictures_of_the_module(exported):
    report = validate(exported.path, RENDER)
    assert report.outcome("GB021").status == "pass"
    assert report.outcome("GM025").status == "pass"
    assert report.findings == ()


def swapped(proto):
    """Exchange red and blue, which no statistic of the numbers shows."""
    for weight in proto.graph.initializer:
        array = numpy_helper.to_array(weight)
        if array.shape == (200, 3) and array.min() >= 0:
            weight.CopyFrom(numpy_helper.from_array(array[:, ::-1].copy(), weight.name))
            return
    raise AssertionError("the model has no table of colours")


def test_swapped_channels_are_seen_at_level_render_without_recorded_rows(exported):
    proto = onnx.load(exported.path)
    swapped(proto)
    path = exported.path.with_name("swapped.onnx")
    onnx.save(proto, path)
    assert validate(path, replace(RENDER, level=Level.BEHAVIOUR)).findings == ()
    findings = validate(path, RENDER).findings
    assert {finding.rule for finding in findings} == {"GB021"}
    assert "swapped channels" in findings[0].hint


def test_more_pictures_than_probes_are_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(ConfigInvalid, match="--pictures") as raised:
        export(Ball(), tmp_path / "ball.onnx", pictures=SourcePictures(9, draw_source_frames))
    assert "expected from 1 to 8" in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_of_a_file_has_no_module_to_draw(tmp_path):
    points = np.random.default_rng(0).normal(size=(9, 3)).astype(np.float32)
    np.savez(tmp_path / "points.npz", points=points, colors=np.abs(np.tanh(points)))
    words = ("export", "static", "points.npz", "-o", "a.onnx", "--pictures", "1")
    completed = gsgen_here(*words, cwd=tmp_path)
    assert (completed.code, completed.out) == (2, "")
    assert "--pictures: only a generator in torch has an eager module to draw" in completed.err
    assert not (tmp_path / "a.onnx").exists()

"""Good models of every producer: the validator finds no fault with any of them."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from contract.rules.producers import ir_models, onnxscript_models, protos, torch_models
from contract.rules.producers.good import Good
from gsgen.conformance.fixtures.valid.avatars import pose_model
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

pytestmark = pytest.mark.slow


MODELS = [
    model
    for producer in (protos, ir_models, onnxscript_models, torch_models)
    for model in producer.models()
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: f"{model.producer}: {model.name}")
def test_good_model_has_no_finding(model: Good, tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(model.draw().SerializeToString())
    report = validate(path, Settings(target=load_target(model.target)))
    complaints = [finding for finding in report.findings if finding.severity > Severity.INFO]
    assert complaints == []
    assert report.verdict == "conforms"
    assert all(level.ran for level in report.levels)


def test_good_models_cover_every_producer(capsys: pytest.CaptureFixture[str]) -> None:
    producers = Counter(model.producer for model in MODELS)
    targets = Counter(model.target for model in MODELS)
    with capsys.disabled():
        counted = ", ".join(f"{name} {count}" for name, count in producers.items())
        print(f"\ngood models: {counted}; {len(MODELS)} in all")
    assert len(MODELS) >= 60
    assert min(producers.values()) >= 7
    assert targets["visionary"] >= 8
    assert targets["webgpu"] >= 20


def test_three_joints_of_a_pose_are_no_matrix(tmp_path: Path) -> None:
    """[3, 3] is a matrix for a root alone: a pose of three joints has that shape, too."""
    skin = np.random.default_rng(2).dirichlet(np.ones(3), 5).astype(np.float32)
    spec = (
        pose_model(shape=(3, 3))
        .replace_text("float[4,3] pose", "float[3,3] pose")
        .with_weights(skin=skin)
    )
    spec.write(tmp_path / "three.onnx")
    report = validate(tmp_path / "three.onnx")
    assert report.verdict == "conforms", report.findings

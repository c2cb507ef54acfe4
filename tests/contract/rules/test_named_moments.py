"""A fault at any moment that the manifest or the specification names is found."""

from functools import cache
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from gsgen.conformance.fixtures import Fixture, find, fixtures
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import make_plan, probed_shapes
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.fields.roles import GENERATOR
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.models.moment_faults import FAULTS, Moment, named_moments, with_fault

_MAX_WEIGHT_BYTES = 1 << 22


@cache
def models_with_inputs() -> tuple[Fixture, ...]:
    """Return the valid examples of every kind that take inputs."""
    return tuple(f for f in fixtures() if not f.rule and f.draw().inputs)


def inspected(path: Path) -> InspectedModel:
    return inspect_model(open_model(path), load_target("core"), Limits())


def moments_of_model(subject: InspectedModel) -> list[Moment]:
    assert subject.manifest is not None
    images = subject.inputs_of("image")
    open_sizes = frozenset(
        entry.name for entry, tensor in images
        if any(not isinstance(dim, int) for dim in tensor.dims or ())
    )  # fmt: skip
    return list(named_moments(subject.manifest, probed_shapes(subject), open_sizes))


@pytest.mark.parametrize("fixture", models_with_inputs(), ids=lambda fixture: fixture.name)
def test_every_named_moment_is_run(fixture: Fixture, tmp_path: Path) -> None:
    path = fixture.write(tmp_path)
    subject = inspected(path)
    assert subject.manifest is not None
    plan = make_plan(subject, Level.BEHAVIOUR)
    model = onnx.load(path)
    judged = [plan.probes[index].inputs for index in (*range(1, plan.values), *plan.moments)]
    missed = []
    for moment in moments_of_model(subject):
        faulty = with_fault(model, subject.manifest, moment, "nan")
        hit = faulty.graph.output.add(name="fault_hit").type.tensor_type
        hit.elem_type = onnx.TensorProto.FLOAT
        hit.shape.SetInParent()
        session = onnxruntime.InferenceSession(
            faulty.SerializeToString(), providers=["CPUExecutionProvider"]
        )
        if not any(session.run(["fault_hit"], inputs)[0] > 0 for inputs in judged):
            missed.append(moment.name)
    assert not missed


@pytest.fixture(scope="module")
def every_fault(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, str, str]]:
    """Model, named moment and fault of every combination."""
    combinations = []
    for fixture in models_with_inputs():
        subject = inspected(fixture.write(tmp_path_factory.mktemp("models")))
        assert subject.manifest is not None
        faults = FAULTS if subject.kind == GENERATOR else FAULTS[:1]
        combinations += [
            (fixture.name, moment.name, fault)
            for moment in moments_of_model(subject)
            for fault in faults
        ]
    return combinations


def is_found(name: str, moment_name: str, fault: str, folder: Path) -> bool:
    """Return whether a model with a fault at one moment is invalid."""
    path = find(name).write(folder)
    subject = inspected(path)
    assert subject.manifest is not None
    moment = next(entry for entry in moments_of_model(subject) if entry.name == moment_name)
    onnx.save(with_fault(onnx.load(path), subject.manifest, moment, fault), path)
    return validate(path, Settings(level=Level.BEHAVIOUR)).verdict == "invalid"


@pytest.mark.parametrize("seed", range(12))
def test_a_fault_at_a_named_moment_is_found(
    seed: int, every_fault: list[tuple[str, str, str]], tmp_path: Path
) -> None:
    assert len({name for name, _, _ in every_fault}) >= 30
    chosen = every_fault[np.random.default_rng(seed).integers(len(every_fault))]
    assert is_found(*chosen, tmp_path), chosen


@pytest.mark.nightly
def test_every_fault_at_every_named_moment_is_found(
    every_fault: list[tuple[str, str, str]], tmp_path: Path
) -> None:
    missed = [entry for entry in every_fault if not is_found(*entry, tmp_path)]
    assert not missed

import logging
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest, GeneratorOutputs
from gsgen.sdk import ExportFailed, GeneratorInvalid, ParityFailed, export
from gsgen.sdk.exporting.eager_reference import EagerRuns
from gsgen.sdk.exporting.parity_diagnosis import Diagnosis, ParitySuspects, diagnose
from gsgen.sdk.exporting.tracing.hazards import HazardWatch
from gsgen.sdk.parity import ModelOutput
from sdk.exporting import hazards
from support.models.generators import Drift, Growing, Lit, Skinned

LINES = Path(hazards.__file__).read_text("utf-8").splitlines()


def hazard_line(kind: type[Drift]) -> str:
    start = LINES.index(f"class {kind.__name__}(Drift):")
    number = next(n for n in range(start, len(LINES)) if "# guilty" in LINES[n])
    return f"hazards.py:{number + 1} ({LINES[number].strip()})"


# What is seen while the module runs, and what comes of its export.
EXPECTED_HAZARDS = {
    hazards.Branches: "branch",
    hazards.BranchesOnItem: "number",
    hazards.GoesThroughNumpy: "numpy",
    hazards.IndexesByMask: "shape",
    hazards.UsesData: "data",
    hazards.Caches: "state",
    hazards.Accumulates: "state",
    hazards.DrawsNumbers: "random",
    hazards.RebuiltFromFloats: "number",
}
REFUSED_HAZARDS = {
    hazards.Branches: (ExportFailed, "torch.where(condition, a, b)"),
    hazards.GoesThroughNumpy: (ExportFailed, "torch function of the same name"),
    hazards.IndexesByMask: (ExportFailed, "gsgen.sdk.math.keep_rows"),
    hazards.Caches: (GeneratorInvalid, "once, in __init__"),
    hazards.Accumulates: (ParityFailed, "once, in __init__"),
    hazards.DrawsNumbers: (ParityFailed, "register_buffer"),
}


@pytest.mark.parametrize("kind", EXPECTED_HAZARDS, ids=lambda kind: kind.__name__)
def test_a_hazard_is_seen_with_its_line_while_the_module_runs(kind: type[Drift]) -> None:
    module, time = kind().eval(), torch.full((1,), 0.2)
    with torch.no_grad(), HazardWatch(module, [time]) as watch:
        module(time)
    line = hazard_line(kind)
    actual = [hazard for hazard in watch.hazards if hazard.where.endswith(line)]
    assert [entry.kind for entry in actual] == [EXPECTED_HAZARDS[kind]]


@pytest.mark.parametrize("kind", [Drift, Lit, Growing, Skinned])
def test_clean_modules_have_no_hazards(kind: type[Drift]) -> None:
    module = kind().eval()
    tensors = [torch.zeros(entry.shape) for entry in module.inputs]
    with torch.no_grad(), HazardWatch(module, tensors) as watch:
        module(*tensors)
    assert watch.hazards == []
    assert not watch.changes_module


def test_watching_leaves_torch_as_it_was() -> None:
    before = torch.nn.Module.__setattr__
    module = Drift()
    with pytest.raises(RuntimeError), HazardWatch(module, []):
        raise RuntimeError
    assert torch.nn.Module.__setattr__ is before


@pytest.mark.parametrize("kind", [hazards.Caches, hazards.Accumulates])
def test_module_state_is_restored_after_a_run(kind: type[Drift]) -> None:
    module, time = kind().eval(), torch.full((1,), 0.7)
    with torch.no_grad(), HazardWatch(module, [time]) as watch:
        first = module(time).position
        module(time)
    assert watch.changes_module
    watch.restore_module()
    with torch.no_grad():
        assert torch.equal(module(time).position, first)
        watch.restore_module()
        assert not torch.equal(module(time * 0.5).position, first)


@pytest.mark.parametrize("kind", REFUSED_HAZARDS, ids=lambda kind: kind.__name__)
def test_a_hazard_that_matters_is_an_error_with_its_line_and_a_cure(
    tmp_path: Path, kind: type[Drift], capfd: pytest.CaptureFixture[str]
) -> None:
    error_type, hint = REFUSED_HAZARDS[kind]
    with pytest.raises(error_type) as caught:
        export(kind(), tmp_path / "m.onnx")
    assert hazard_line(kind) in str(caught.value)
    assert hint in caught.value.hint
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")  # torch prints graphs of what it gives up
    assert logging.root.manager.disable == logging.NOTSET


def test_harmless_hazard_is_not_reported(tmp_path: Path) -> None:
    exported = export(hazards.RebuiltFromFloats(), tmp_path / "m.onnx")
    assert exported.parity.holds
    assert exported.parity.probes == 13


# ---- Why a model differs, where no line was seen -----------------------------------------------

MANIFEST = GeneratorManifest(name="m", outputs=GeneratorOutputs(), inputs=tuple(Drift.inputs))
PROBES = [Probe(label=f"time={t}", inputs={"time": np.float32([t])}) for t in (0.2, 0.4, 1.0)]


def export_error(module: Drift, *, frozen: bool = False, rewritten: bool = True) -> Diagnosis:
    """Explain a model that always emits its first frame, or one that follows."""

    def run(probes: list[Probe]) -> list[ModelOutput]:
        moments = [0.0 if frozen else float(p.inputs["time"][0]) for p in probes]
        return [ModelOutput(np.full((3, 10), t), np.zeros((3, 48)), 3) for t in moments]

    module = module.eval()
    references = EagerRuns(module, PROBES)
    suspects = ParitySuspects(module, PROBES[0], (), rewritten)
    return diagnose(suspects, MANIFEST, references, run)


def test_an_input_that_lost_its_effect_is_named() -> None:
    cause = export_error(Drift(), frozen=True)
    assert cause.reason == "; time has no effect in the model"
    assert "outside of torch" in cause.hint
    assert export_error(Drift()) == Diagnosis("", cause.hint)


def test_a_result_that_changes_by_itself_is_named() -> None:
    cause = export_error(hazards.ReadsAClock())
    assert cause.reason == "; a value of Python or numpy changes from run to run"
    assert "default_rng" in cause.where


def test_a_graph_that_was_not_rewritten_is_named() -> None:
    assert "export with rewrites" in export_error(Drift(), rewritten=False).hint


class Raising(Drift):
    def forward(self, time: torch.Tensor):
        return super().forward(time @ self.rest)


def test_exception_of_forward_is_reported_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(GeneratorInvalid) as caught:
        export(Raising(), tmp_path / "m.onnx")
    assert isinstance(caught.value, GsgenError)
    assert "test_trace_hazards.py" in caught.value.where
    assert "time @ self.rest" in caught.value.where
    assert "forward raised RuntimeError" in caught.value.message

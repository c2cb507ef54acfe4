"""Models in ONNX Runtime's WebGPU provider, captured and replayed; `make drivers` first."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.conformance.fixtures import Fixture
from gsgen.conformance.fixtures.builders.arrays import i64
from gsgen.conformance.fixtures.builders.images import darken
from gsgen.conformance.fixtures.builders.moving import camera_dependent_model, drifting_model
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.formats import open_splats, write_ply
from gsgen.reference_plugins.static.static import from_content
from gsgen.reference_plugins.synthetic import torus_knot
from gsgen.sdk.live.fixtures import live_fixtures
from support.models.generators import Drift, Growing, Lit, Skinned
from support.models.static_scenes import write_scene

LIVE_SETTINGS = Settings(level=Level.LIVE)
RULES = [rule for rule in installed_rules().rules.values() if rule.level is Level.LIVE]
DTYPES = ("float32", "float16")
END = "gaussians = Concat <axis = 1> (moved, opacity, spread)"


@pytest.fixture(scope="module")
def broken(tmp_path_factory) -> dict[str, Report]:
    """The reports of all examples, by the rule that each breaks."""
    folder = tmp_path_factory.mktemp("broken")
    return {
        live_fixture.rule: validate_live(live_fixture.write(folder))
        for live_fixture in live_fixtures()
    }


def validate_live(path) -> Report:
    """Judge a model; that it cannot run live here is a fault of this machine, not a reason."""
    return ran_live(validate(path, LIVE_SETTINGS))


def ran_live(report: Report) -> Report:
    (level,) = (level for level in report.levels if level.level is Level.LIVE)
    assert level.ran, f"{level.reason}; install a driver with `make drivers`"
    return report


def passes(report: Report) -> None:
    """Assert that every rule holds: all nodes on the GPU, captured, replayed, and right."""
    assert report.findings == ()
    assert {rule.id: report.outcome(rule.id).status for rule in RULES} == {
        rule.id: "pass" for rule in RULES
    }
    assert report.environment["capture"].startswith("accepted, ")


def message(report: Report, rule: str) -> str:
    (actual,) = (finding for finding in report.findings if finding.rule == rule)
    return f"{actual.where}: {actual.message}"


def test_there_is_one_example_for_each_rule():
    assert [fixture.rule for fixture in live_fixtures()] == [rule.id for rule in RULES]


@pytest.mark.parametrize("fixture", live_fixtures(), ids=lambda fixture: fixture.name)
def test_a_broken_model_breaks_its_rule_and_no_other(fixture: Fixture, broken):
    report = broken[fixture.rule]
    expected_warnings = {"GB014": {"GG003"}}.get(fixture.rule, set())
    expected = {fixture.rule} | expected_warnings  # a rule of the graph has seen it coming
    assert {finding.rule for finding in report.findings} == expected
    severity = report.outcome(fixture.rule).rule.severity
    assert report.verdict == ("invalid" if severity is Severity.ERROR else "conforms")
    assert not any(outcome.status == "crashed" for outcome in report.outcomes)


def test_finding_message_describes_the_fault(broken):
    expected_message = {rule: message(report, rule) for rule, report in broken.items()}
    assert expected_message["GB011"].startswith("field position: off by ")
    assert expected_message["GB014"] == (
        "graph: This session cannot use the graph capture feature as requested by the user as "
        "the model has control flow nodes which can't be supported by WebGpuExecutionProvider; "
        "expected a session that captures"
    )
    assert expected_message["GB015"] == (
        "node Round (Round): runs in CPUExecutionProvider; expected a kernel in the WebGPU provider"
    )
    assert expected_message["GB016"] == (
        "output gaussians: repeats frame 0 in all 6 replays; made by ReduceSum (node ReduceSum); "
        "expected the output of the session without capture"
    )
    assert expected_message["GB017"].startswith("graph: stopped in frame 0 (plain session): ")
    assert "Too many storage buffers in shader" in expected_message["GB017"]


@pytest.mark.parametrize(
    ("operator", "end", "dtype"),
    [
        ("Reshape", "gaussians = Reshape (packed, shape)", "float16"),
        ("Squeeze", "on = Unsqueeze (packed, first) gaussians = Squeeze (on, first)", "float32"),
        ("Max", "gaussians = Max (packed)", "float32"),
        ("", "gaussians = Mul (packed, unit)", "float16"),
        ("", "on = Reshape (packed, shape) gaussians = Clip (on)", "float32"),
    ],
)
def test_an_output_that_is_a_copy_is_caught_and_its_operator_named(operator, end, dtype, tmp_path):
    concat_text = "packed = Concat <axis = 1> (moved, opacity, spread)"
    half = dtype == "float16"
    narrow_text = f"{concat_text.replace('packed', 'wide')} packed = Cast <to = 10> (wide)"
    before = "gaussians = Cast <to = 10> (packed)" if half else END
    spec = drifting_model(dtype=dtype)
    spec = spec.replace_text(concat_text, "") if half else spec
    spec = spec.replace_text(before, f"{narrow_text if half else concat_text} {end}")
    weights = {"shape": i64(5, 10), "first": i64(0), "unit": np.ones(1, dtype)}
    used = {name: array for name, array in weights.items() if name in end}
    spec.with_weights(**used).write(tmp_path / "a.onnx")
    report = validate_live(tmp_path / "a.onnx")
    assert report.outcome("GB016").status == ("fail" if operator else "pass")
    if operator:
        assert f"made by {operator} (node {operator})" in message(report, "GB016")


def test_an_output_that_no_manifest_declares_is_compared_too(tmp_path):
    path = tmp_path / "a.onnx"
    spec = drifting_model().replace_text(END, f"{END} clock = Identity (time)")
    replace(spec, outputs=f"{spec.outputs}, float[1] clock").write(path)
    assert message(validate_live(path), "GB016").startswith(
        "output clock: repeats frame 0 in all 6 replays; made by Identity"
    )


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("draw", [drifting_model, camera_dependent_model])
def test_moving_models_pass(draw, dtype, tmp_path):
    draw(degree=3, dtype=dtype).write(tmp_path / "a.onnx")
    passes(validate_live(tmp_path / "a.onnx"))


def test_a_model_of_images_passes(tmp_path):
    darken().write(tmp_path / "a.onnx")
    passes(validate_live(tmp_path / "a.onnx"))


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_static_scene_passes(dtype, tmp_path):
    write_ply(tmp_path / "knot.ply", torus_knot(512))
    scene = from_content(open_splats(tmp_path / "knot.ply"), dtype=dtype)
    write_scene(scene, tmp_path / "a.onnx")
    report = validate_live(tmp_path / "a.onnx")
    passes(report)
    assert report.environment["capture"] == "accepted, 3 replays"


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("generator_class", [Drift, Lit, Growing, Skinned])
def test_exported_models_pass(generator_class, dtype, exported):
    passes(ran_live(validate(exported(generator_class, dtype), LIVE_SETTINGS)))

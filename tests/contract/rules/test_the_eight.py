"""Eight models that ONNX's checker and ONNX Runtime take without a word, and no viewer draws.

Each is the same good model with one thing changed. What is asserted is everything that the
validator finds, for the strictest consumer: no rule fewer, and no rule more.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from gsgen.conformance.fixtures.builders.arrays import i64
from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GaussiansOutput
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

ROWS = 256


@dataclass(frozen=True, slots=True)
class Case:
    """A model, and all that is wrong with it.

    Attributes:
        draw: Draws the model.
        findings: Rule → its name, who says so, and the facts that its place or message must contain.
    """

    draw: Callable[[], ModelSpec]
    findings: Mapping[str, tuple[str, str, tuple[str, ...]]]


def good() -> ModelSpec:
    """What the eight are made from: float16, SH of degree 3, a whole workgroup of rows."""
    return still(ROWS, degree=3, dtype="float16")


def hostile_values() -> ModelSpec:
    negative = -good().weights["rows"][4, 4:]
    one_nan = good().with_weight_values("rows", np.s_[2, 0], np.nan)
    return one_nan.with_weight_values("rows", np.s_[3, 3], 5).with_weight_values(
        "rows", np.s_[4, 4:], negative
    )


def other_name() -> ModelSpec:
    splats = GaussiansOutput("splats", ROWS, "float16")
    return good().replace_text("gaussians", "splats").with_outputs(gaussians=splats)


def name_that_the_manifest_has_not() -> ModelSpec:
    return good().replace_text("gaussians", "splats")


def sh_of_12() -> ModelSpec:
    return still(ROWS, degree=1, dtype="float16")


def half_rgb_of_3() -> ModelSpec:
    four_channel_model = still(ROWS, degree=None, dtype="float16")
    three = four_channel_model.weights["colors"][:, :3]
    return four_channel_model.replace_text("[256,4]", "[256,3]").with_weights(colors=three)


def mixed_precision() -> ModelSpec:
    float32_colors = good().weights["colors"].astype(np.float32)
    return (
        good().replace_text("float16[256,48]", "float[256,48]").with_weights(colors=float32_colors)
    )


def no_count() -> ModelSpec:
    without = good().replace_text(", int32[1] num_points", "")
    return without.replace_text("num_points = Identity (live)", "").with_outputs(count=None)


def count_of_int64() -> ModelSpec:
    return good().replace_text("int32[1]", "int64[1]").with_weights(live=i64(ROWS))


def symbolic_rows() -> ModelSpec:
    """As many rows as are kept: the number is only known once the model has run."""
    compress = "Compress <axis = 0> ({}, wanted)"
    cut = good().replace_text("Identity (rows)", compress.format("rows"))
    cut = cut.replace_text("Identity (colors)", compress.format("colors"))
    open_ended = cut.replace_text("[256,10]", "[N,10]").replace_text("[256,48]", "[N,48]")
    return open_ended.with_weights(wanted=np.ones(ROWS, np.bool_))


CASES = {
    "NaN, opacity 5, negative covariance": Case(
        hostile_values,
        {
            "GV001": ("rows-finite", "contract", ("1 of 256 rows", "row 2", "nan")),
            "GV003": ("opacity-range", "contract", ("row 3", ": 5;", "0 <= opacity <= 1")),
            "GV005": (
                "variance-not-negative",
                "contract",
                ("row 4", ": -0.0375", "xx, yy, zz >= 0"),
            ),
        },
    ),
    "a name that no viewer looks for": Case(
        other_name,
        {
            "TV101": (
                "visionary-finds-gaussians",
                "visionary@1.0.1",
                ("output splats", "starts with 'gauss'"),
            )
        },
    ),
    "a name that the manifest has not": Case(
        name_that_the_manifest_has_not,
        {
            "GM004": (
                "declared-tensors-exist",
                "contract",
                ("output 'gaussians'", "splats, color, num_points"),
            )
        },
    ),
    "SH12": Case(
        sh_of_12,
        {
            "TV104": (
                "visionary-reads-color",
                "visionary@1.0.1",
                ("SH with 12 channels", "48 channels"),
            )
        },
    ),
    "RGB3 in float16": Case(
        half_rgb_of_3,
        {
            "GO015": (
                "rows-fill-words",
                "contract",
                ("output color", "3 channels of float16", "6 bytes a row", "multiple of 4 bytes"),
            ),
            "TV104": (
                "visionary-reads-color",
                "visionary@1.0.1",
                ("RGB as float16 with 3 channels", "float16 with 4 channels"),
            ),
        },
    ),
    "mixed precision": Case(
        mixed_precision,
        {
            "GO009": (
                "output-dtypes-match",
                "visionary@1.0.1",  # to the contract alone it is a warning
                ("output color", "float32", "expected float16, as gaussians"),
            )
        },
    ),
    "no count": Case(
        no_count, {"GO010": ("count-declared", "contract", ("no row count", "int32 [1]"))}
    ),
    "a count of int64": Case(
        count_of_int64,
        {
            "GO011": (
                "count-is-int32",
                "contract",
                ("output num_points", "int64 [1]", "expected int32 [1]"),
            )
        },
    ),
    "symbolic N": Case(
        symbolic_rows,
        {
            "GO004": (
                "capacity-static",
                "contract",
                ("output gaussians", "[N, 10]", "a fixed, positive number"),
            )
        },
    ),
}


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


def validate_spec(spec: ModelSpec, folder: Path) -> Report:
    path = folder / "model.onnx"
    spec.write(path)
    return validate(path, Settings(target=load_target("visionary")))


def test_faulty_model_passes_checker_and_runtime(case: Case) -> None:
    model = case.draw().build()
    onnx.checker.check_model(model, full_check=True)
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    rows, colors, *_ = session.run(None, {})
    assert rows.shape == (ROWS, 10)
    assert len(colors) == ROWS


def test_validator_reports_exactly_the_built_in_faults(case: Case, tmp_path: Path) -> None:
    report = validate_spec(case.draw(), tmp_path)
    assert report.verdict == "invalid"
    assert {finding.rule for finding in report.findings} == set(case.findings)
    assert len(report.findings) == len(case.findings)
    for finding in report.findings:
        slug, source, facts = case.findings[finding.rule]
        assert (finding.slug, finding.source) == (slug, source)
        assert finding.severity.word == "error"
        assert finding.certainty == "confirmed"
        for fact in facts:
            assert fact in f"{finding.where}: {finding.message}"


def test_base_model_of_the_faults_is_valid(tmp_path: Path) -> None:
    report = validate_spec(good(), tmp_path)
    assert (report.verdict, report.findings) == ("conforms", ())

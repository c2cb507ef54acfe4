"""The live level where something is missing, hangs or dies; and how outputs are compared."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from onnx import parser

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.level_backend import LevelUnavailable
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.binding.providers.webgpu import WEBGPU, AdapterMissing
from gsgen.sdk.doctor import checks
from gsgen.sdk.live import level as live
from gsgen.sdk.live import worker
from gsgen.sdk.live.comparison import disagreements, wrong_replays
from gsgen.sdk.live.level import Frame, LiveLevel, Node, survey
from support.models.captured import CAPTURED
from support.models.small_models import (
    HEAD,
    good_rows,
    manifest_of,
    moving,
    save,
    save_moving,
    weight,
)

LIVE_SETTINGS = Settings(level=Level.LIVE)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return save_moving(tmp_path_factory.mktemp("good") / "good.onnx", good_rows(8))


def reason_to_skip(report: Report) -> str:
    (level,) = (level for level in report.levels if level.level is Level.LIVE)
    assert not level.ran
    for rule in CAPTURED:
        outcome = report.outcome(rule)
        assert (outcome.status, outcome.reason) == ("skipped", level.reason)
    assert report.verdict == "conforms"
    return level.reason


# ---- What is missing -------------------------------------------------------------------------


def test_without_the_package_the_level_is_skipped(good, monkeypatch):
    monkeypatch.setattr(live, "find_spec", lambda name: None)
    reason = reason_to_skip(validate(good, LIVE_SETTINGS))
    assert reason == "onnxruntime-ep-webgpu is not installed: pip install 'gsgen[live]'"


def test_without_an_adapter_the_level_is_skipped(good, monkeypatch):
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    assert reason_to_skip(validate(good, LIVE_SETTINGS)) == (
        "there is no usable WebGPU adapter (Failed to get a WebGPU adapter: No supported adapters)"
        ": install a Vulkan driver, such as mesa-vulkan-drivers 25"
    )


def test_a_user_may_refuse_software_adapters(good, monkeypatch):
    monkeypatch.setenv("ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER", "0")
    assert re.search("lists no device for WebGPU|hardware", adapter_or_reason())


def adapter_or_reason() -> str:
    try:
        return survey()["adapter"]
    except LevelUnavailable as error:
        return error.reason


def test_the_doctor_names_the_adapter():
    (check,) = (check for check in checks() if check.name == "webgpu")
    assert check.state == "ok", f"{check.detail}; install a driver with `make drivers`"
    assert check.detail.endswith("float16)")


def test_the_doctor_says_what_is_missing(monkeypatch):
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    (check,) = (check for check in checks() if check.name == "webgpu")
    assert check.state == "missing"
    assert "No supported adapters" in check.detail
    assert check.remedy.startswith("install a Vulkan driver")


@pytest.mark.parametrize("half", [False, True])
def test_an_adapter_without_float16_refuses_only_models_that_need_it(half, tmp_path):
    (tmp_path / "log").write_text('Using "Old Card" with driver: "old.so"')

    class Session:
        def run(self, _, inputs):
            if inputs["x"].dtype == np.float16:
                raise RuntimeError("requires f16 but the device does not support it")
            return [2 * inputs["x"]]

    received = []

    def emit(event, **facts):
        received.append((event, facts))

    def attempt():
        worker._try_adapter(lambda *_, **__: Session(), tmp_path, emit, half=half)

    if half:
        with pytest.raises(AdapterMissing, match="adapter Old Card no shader-f16"):
            attempt()
    else:
        attempt()
    assert received == [("adapter", {"name": "Old Card", "software": False, "half": False})]


# ---- What dies, hangs or deceives ------------------------------------------------------------


@pytest.fixture
def misbehaving_child(monkeypatch):
    """Let the child be one that misbehaves in a given way."""

    def behave(how):
        monkeypatch.setattr(live, "_WORKER", "sdk.live.misbehaving_worker")
        monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
        monkeypatch.setenv("HOW_THE_WORKER_BEHAVES", how)

    return behave


def test_a_provider_that_dies_before_the_model_is_loaded_skips_the_level(good, misbehaving_child):
    misbehaving_child("crash at once")
    assert reason_to_skip(validate(good, LIVE_SETTINGS)) == (
        "the WebGPU provider does not start (ended by signal SIGSEGV): run `gsgen doctor`"
    )


def test_a_session_that_fell_back_to_the_cpu_is_a_crash_never_a_pass(good, misbehaving_child):
    misbehaving_child("fall back")
    report = validate(good, LIVE_SETTINGS)
    assert report.verdict == "internal-error"
    for rule in CAPTURED:
        assert report.outcome(rule).status == "crashed"
        assert report.outcome(rule).reason.endswith(
            "ONNX Runtime fell back to the CPU: wanted this, got that"
        )


def test_a_model_that_kills_the_process_breaks_a_rule(good, misbehaving_child):
    misbehaving_child("crash in a replay")
    report = validate(good, LIVE_SETTINGS)
    (finding,) = report.findings
    assert (finding.rule, report.verdict) == ("GB017", "invalid")
    assert finding.message.startswith(
        "stopped in frame 1 (captured session): ended by signal SIGSEGV; "
    )
    for rule in ("GB011", "GB014", "GB015", "GB016"):
        assert report.outcome(rule).reason == "because GB017 does not hold"


def test_a_model_that_is_out_of_time_on_the_gpu_is_not_checked(tmp_path):
    proto = moving(good_rows(5))
    text = """
    g (float[1] time) => (float[1] y) <int64 turns = {100000}, bool yes = {1}> {
        y = Loop (turns, yes, time) <body = b (int64 i, bool c, float[1] v) =>
            (bool d, float[1] w) { d = Identity (c) w = Sin (v) }>
    }
    """
    loop = parser.parse_model(HEAD + text)
    proto.graph.node.insert(0, loop.graph.node[0])
    proto.graph.node[1].input[0] = "y"
    proto.graph.initializer.extend(loop.graph.initializer)
    path = save(tmp_path / "a.onnx", proto, manifest_of(5))
    report = validate(path, replace(LIVE_SETTINGS, limits=Limits(seconds=5)))
    assert report.outcome("GV025").status == "pass"
    outcome = report.outcome("GB017")
    assert outcome.status == "skipped"
    assert outcome.reason.startswith("not checked: out of time, still running after 5 s")
    assert "--timeout" in outcome.reason
    assert not {finding.rule for finding in report.findings} & {"GB017", *CAPTURED}


# ---- How outputs are compared ----------------------------------------------------------------


def live_run(path, *frames, **changes) -> LiveLevel:
    subject = inspect_model(open_model(path), LIVE_SETTINGS.target, Limits())
    result = [Frame(Probe(label=f"probe {k}", inputs={}), *three) for k, three in enumerate(frames)]
    facts = {"nodes": (), "is_capture_accepted": True, "stop": None} | changes
    return LiveLevel(subject=subject, adapter="made up", frames=tuple(result), **facts)


def outputs(rows, count=None):
    n = len(rows)
    colors = np.full((n, 3), 0.5, np.float32)
    live_rows = np.array([n if count is None else count], np.int32)
    return {"gaussians": rows, "color": colors, "num_points": live_rows}


@pytest.mark.parametrize(
    ("row", "column", "factor", "field"),
    [
        (3, 0, 5e-5, ""),  # half a thousandth of a standard deviation of 0.1
        (3, 0, 2e-4, "position"),
        (7, 4, 1e-5, ""),
        (7, 4, 1e-4, "covariance"),
        (0, 3, 1e-3, ""),
        (0, 3, 4e-3, "opacity"),
        (5, 3, np.nan, "opacity"),
    ],
)
def test_cpu_and_gpu_are_compared_field_by_field(good, row, column, factor, field):
    rows = good_rows(8)
    changed = rows.copy()
    changed[row, column] += factor
    same = outputs(rows)
    actual = list(disagreements(live_run(good, (same, same, None), (same, outputs(changed), None))))
    assert [location for location, _, _ in actual] == ([f"field {field}"] if field else [])
    if field:
        assert f"row {row}, " in actual[0][1]
        assert actual[0][1].endswith("(probe 1)")


def test_another_count_is_a_disagreement(good):
    rows = good_rows(8)
    actual = list(disagreements(live_run(good, (outputs(rows), outputs(rows, 7), None))))
    assert [location for location, _, _ in actual] == ["field count"]


def test_rows_behind_the_count_are_not_compared(good):
    rows = good_rows(8)
    other = rows.copy()
    other[6:] = 0
    assert not list(disagreements(live_run(good, (outputs(rows, 6), outputs(other, 6), None))))


def test_one_unit_in_the_last_place_of_float16_is_no_disagreement(good):
    rows = good_rows(8).astype(np.float16)
    rows[:, [4, 7, 9]] = 1e-4
    other = rows.copy()
    other[:, :3] = np.nextafter(other[:, :3], np.float16(2))
    color = np.full((8, 4), 0.5, np.float16)
    pair = [outputs(array) | {"color": color} for array in (rows, other)]
    assert not list(disagreements(live_run(good, (*pair, None))))


def test_output_undefined_on_the_cpu_is_not_a_stale_replay(good):
    rows = good_rows(8)
    rows[2, 0] = np.nan
    other = rows.copy()
    other[2, 0] = 3
    assert not list(wrong_replays(live_run(good, (outputs(rows), outputs(rows), outputs(other)))))


def frames_of(original, replayed):
    return [
        (
            {},
            {"gaussians": np.full((8, 10), a, np.float32)},
            {"gaussians": np.full((8, 10), b, np.float32)},
        )
        for a, b in zip(original, replayed, strict=True)
    ]


@pytest.mark.parametrize(
    ("replayed", "how"),
    [
        ((1, 2, 3), ""),
        ((1, 1, 1), "repeats frame 0 in all 2 replays; made by Add (node Add)"),
        ((1, 2, 2), "1 of 3 frames differ, the first is frame 2; made by Add (node Add)"),
        ((0, 0, 0), "3 of 3 frames differ, the first is frame 0; made by Add (node Add)"),
    ],
)
def test_replays_are_compared_with_plain_runs(good, replayed, how):
    actual = list(wrong_replays(live_run(good, *frames_of((1, 2, 3), replayed))))
    assert [entry.actual for entry in actual] == ([how] if how else [])


@pytest.mark.parametrize(
    ("text", "expected_message"),
    [
        ("gaussians = Reshape (time, s)", "made by Reshape (node Reshape)"),
        ("gaussians = Identity (time)", "made by Identity (node Identity)"),
        (
            "mixed = ScatterND (base, at, time) gaussians = Add (mixed, mixed)",
            "computed from ScatterND (node ScatterND)",
        ),
        (
            "whole = Cast <to = 7> (time) gaussians = Cast <to = 1> (whole)",
            "computed from int64 Cast (node Cast)",
        ),
        ("gaussians = Add (time, time)", "made by Add (node Add)"),
    ],
)
def test_offending_operator_is_named(text, expected_message, tmp_path):
    proto = parser.parse_model(f"{HEAD} g (float[8] time) => (float[8] gaussians) {{ {text} }}")
    inputs = {
        "s": np.array([8], np.int64),
        "base": np.zeros(8, np.float32),
        "at": np.arange(8, dtype=np.int64)[:, None],
    }
    proto.graph.initializer.extend(
        weight(k, v) for k, v in inputs.items() if f"{k}," in text or f" {k})" in text
    )
    path = save(tmp_path / "a.onnx", proto)
    (wrong_replay,) = wrong_replays(live_run(path, *frames_of((1, 2, 3), (1, 1, 1))))
    assert wrong_replay.actual == f"repeats frame 0 in all 2 replays; {expected_message}"


def test_a_still_output_has_nothing_to_go_stale(good):
    assert not list(wrong_replays(live_run(good, *frames_of((1, 1, 1), (1, 1, 1)))))


def test_node_placement_is_reported_by_name(good):
    nodes = (Node(WEBGPU, "Add", "a"), Node("CPUExecutionProvider", "Round", "r"))
    assert live_run(good, nodes=nodes).nodes[1].name == "r"
    assert live_run(good).state == "accepted, 0 replays"
    assert live_run(good, is_capture_accepted=False).state == "not tried"

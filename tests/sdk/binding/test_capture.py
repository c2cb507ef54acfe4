"""A capture is trusted only after it was compared with plain runs."""

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.sdk.binding import CaptureOff, FrameSession, NodesOnCpu, RunFailed
from gsgen.sdk.binding.bound import warm_up


def moves(session: FrameSession) -> None:
    """Assert that frames are those of the CPU."""
    with FrameSession(session.path, provider="cpu") as reference:
        for time in (0.0, 0.5, 1.0):
            expected = reference.run({"time": time})["gaussians"]
            actual = session.run({"time": time})["gaussians"]
            np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_stale_capture_is_disabled_and_its_operator_named(models):
    with pytest.warns(CaptureOff) as warning_records:
        session = FrameSession(models["output_from_idle_sum"], provider="webgpu")
    cause = "output gaussians repeats frame 0 in all 1 replays; made by ReduceSum (node ReduceSum)"
    assert [str(entry.message) for entry in warning_records] == [
        f"output_from_idle_sum.onnx runs without capture on webgpu: {cause}"
    ]
    assert warning_records[0].filename == __file__  # it points at the caller
    with session:
        assert (session.captured, session.cause) == (False, cause)
        moves(session)


def test_without_the_check_the_stale_frame_would_be_shown(models, monkeypatch):
    """What the check is for: ONNX Runtime itself reports nothing."""
    monkeypatch.setattr(warm_up, "wrong_outputs", lambda *_: iter(()))
    with FrameSession(models["output_from_idle_sum"], provider="webgpu") as session:
        assert session.captured
        with pytest.raises(AssertionError):
            moves(session)


def test_refused_capture_is_disabled_and_the_operator_named(models):
    with pytest.warns(CaptureOff, match=r"control flow nodes .* \(If\)$"):
        session = FrameSession(models["branches_by_if"], provider="webgpu")
    with session:
        assert not session.captured
        moves(session)


def test_nodes_that_fell_back_to_the_cpu_are_reported(models):
    with (
        pytest.warns(CaptureOff, match=r"not been partitioned .* \(Round\)$"),
        pytest.warns(NodesOnCpu, match=r"webgpu: 1 of \d+ nodes run on the CPU \(Round\)$"),
    ):
        session = FrameSession(models["round_on_the_cpu"], provider="webgpu")
    with session:
        assert [node.operator for node in session.left_on_cpu] == ["Round"]
        moves(session)


def test_capture_can_be_left_off(models):
    with FrameSession(
        models["output_from_idle_sum"], provider="webgpu", capture=False
    ) as frame_session:
        assert (frame_session.captured, frame_session.cause) == (False, "")
        moves(frame_session)


def test_a_refusal_at_the_first_captured_run_is_a_cause_too(models, monkeypatch):
    run = warm_up.BoundSession.run
    refused = []

    def refuse_once(bound):
        if not refused:
            refused.append(bound)
            raise RuntimeError("[ONNXRuntimeError] : 1 : FAIL : no room for commands")
        run(bound)

    monkeypatch.setattr(warm_up.BoundSession, "run", refuse_once)
    with pytest.warns(CaptureOff, match="on webgpu: no room for commands$"):
        session = FrameSession(models["drift-float32"], provider="webgpu")
    with session:
        moves(session)


def test_a_model_that_does_not_run_there_is_an_error(models):
    with pytest.raises(RunFailed, match="Too many storage buffers in shader") as raised:
        FrameSession(models["split_into_many"], provider="webgpu")
    assert raised.value.hint.startswith("`gsgen validate --level live`")


def test_an_output_that_no_manifest_declares_is_compared_too(tmp_path):
    from dataclasses import replace

    end = "gaussians = Concat <axis = 1> (moved, opacity, spread)"
    spec = drifting_model().replace_text(end, f"{end} clock = Identity (time)")
    replace(spec, outputs=f"{spec.outputs}, float[1] clock").write(tmp_path / "a.onnx")
    with pytest.warns(CaptureOff, match="output clock repeats frame 0 .* made by Identity"):
        session = FrameSession(tmp_path / "a.onnx", provider="webgpu")
    with session:
        assert session.run({"time": 0.5})["clock"].tolist() == [0.5]


def test_time_that_loops_is_tried_at_two_moments_that_differ(models):
    with FrameSession(models["drift-float32"], provider="cpu") as session:
        first, second = session.samples()
    assert 0 <= first["time"][0] < second["time"][0] < 1


@pytest.mark.parametrize("base", ["moved", "base"])
def test_a_scatter_that_meets_its_own_leftovers_is_caught(base, tmp_path):
    """ScatterND writes in place: what the frame before left is there still."""
    end = "gaussians = Concat <axis = 1> (moved, opacity, spread)"
    body = (
        f'part = Slice (moved, low, high) some = ScatterND <reduction = "add"> ({base}, at, part) '
        "sum = Add (moved, some) gaussians = Concat <axis = 1> (sum, opacity, spread)"
    )
    weights = {
        "at": np.arange(2)[:, None],
        "low": np.zeros(1, np.int64),
        "high": np.full(1, 2),
        "base": np.ones((5, 3), np.float32),
    }
    used = {name: array for name, array in weights.items() if f"{name}," in body or name == "high"}
    drifting_model().replace_text(end, body).with_weights(**used).write(tmp_path / "a.onnx")
    with pytest.warns(CaptureOff, match=r"computed from ScatterND \(node ScatterND\)$"):
        session = FrameSession(tmp_path / "a.onnx", provider="webgpu")
    with session:
        moves(session)

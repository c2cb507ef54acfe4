"""Which provider is chosen and why, and what ONNX Runtime is told; CUDA by its arguments alone."""

import sys
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest

from gsgen.contract.errors import UnknownName
from gsgen.sdk.binding import CaptureOff, FrameSession, NodesOnCpu, ProviderUnavailable
from gsgen.sdk.binding.bound import warm_up
from gsgen.sdk.binding.providers import selection, webgpu
from gsgen.sdk.binding.providers.node_placement import error_text
from gsgen.sdk.binding.providers.selection import (
    ProviderChoice,
    SessionOptions,
    choose_provider,
    installed_providers,
    open_session,
)
from gsgen.sdk.binding.providers.webgpu import Adapter, AdapterMissing, find_adapter


def test_without_a_gpu_the_cpu_is_chosen(models):
    with FrameSession(models["drift-float32"]) as session:
        assert (session.provider, session.device) == ("cpu", "CPU")
        assert (
            session.reason
            == "WebGPU has only a software driver, which is slower than the CPU provider"
        )


def test_without_the_package_the_cpu_is_chosen(monkeypatch):
    monkeypatch.setattr(selection, "find_spec", lambda name: None)
    assert choose_provider().reason == "neither CUDA nor onnxruntime-ep-webgpu is installed"
    assert installed_providers() == ["cpu"]


def test_a_gpu_is_preferred(monkeypatch):
    gpu = Adapter(None, "Fast Card", "0", hardware=True)
    monkeypatch.setattr(selection, "find_adapter", lambda: gpu)
    chosen = choose_provider()
    assert (chosen.provider, chosen.device, chosen.is_requested) == ("webgpu", "Fast Card", False)
    assert chosen.reason == "WebGPU has a GPU: Fast Card"


def test_without_a_device_the_cpu_is_chosen_unless_webgpu_was_asked_for(monkeypatch):
    def missing():
        raise AdapterMissing("ONNX Runtime lists no device", "install a driver")

    monkeypatch.setattr(selection, "find_adapter", missing)
    assert choose_provider().reason == "ONNX Runtime lists no device"
    with pytest.raises(ProviderUnavailable) as raised:
        choose_provider("webgpu")
    assert str(raised.value) == (
        "provider webgpu: ONNX Runtime lists no device\n  install a driver"
    )


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime_ep_webgpu", None)
    with pytest.raises(AdapterMissing, match="onnxruntime-ep-webgpu is not installed"):
        find_adapter()


def test_an_onnx_runtime_without_plug_ins_is_named(monkeypatch):
    # A fake of an ONNX Runtime without plug-in providers.
    monkeypatch.delattr(onnxruntime, "register_execution_provider_library")
    with pytest.raises(AdapterMissing, match="does not support plug-in providers") as raised:
        find_adapter()
    assert raised.value.hint == "pip install -U onnxruntime"


def test_missing_device_counts_as_absence(monkeypatch):
    monkeypatch.setattr(webgpu, "_is_plugin_registered", True)
    monkeypatch.setattr(onnxruntime, "get_ep_devices", list)  # a fake: no device
    with pytest.raises(AdapterMissing, match="lists no device for WebGPU"):
        find_adapter()


def test_the_provider_is_registered_once(models):
    """ONNX Runtime dies at the session after a second registration."""
    for _ in range(2):
        find_adapter()
        FrameSession(models["drift-float32"], provider="webgpu").close()
    assert webgpu._is_plugin_registered


def test_a_provider_that_does_not_exist_is_refused(models):
    with pytest.raises(UnknownName) as raised:
        FrameSession(models["drift-float32"], provider="wgpu")
    assert raised.value.hint == "Did you mean 'webgpu'?"


def test_a_provider_that_fails_gives_way_to_the_cpu_if_nobody_asked_for_it(models, monkeypatch):
    adapter = find_adapter()
    monkeypatch.setattr(
        selection, "find_adapter", lambda: Adapter(adapter.device, "Card", "0", hardware=True)
    )
    with FrameSession(models["split_into_many"]) as session:
        assert session.provider == "cpu"
        assert session.reason.startswith("webgpu failed: ")
        assert "Too many storage buffers" in session.reason
        session.run({"time": 0.5})


def test_session_without_its_provider_is_refused(models, monkeypatch):
    class Fallen:
        def __init__(self, *_, **__):
            pass

        def get_providers(self):
            return ["CPUExecutionProvider"]

    monkeypatch.setattr(onnxruntime, "InferenceSession", Fallen)  # a fake: no WebGPU
    with pytest.raises(ProviderUnavailable, match=r"runs on CPUExecutionProvider, expected WebGpu"):
        open_session(
            models["drift-float32"], SessionOptions(choice=choose_provider("webgpu"), capture=True)
        )


def test_an_adapter_that_cannot_be_had_is_an_absence(models, monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("Failed to get a WebGPU adapter: No supported adapters")

    monkeypatch.setattr(onnxruntime, "InferenceSession", refuse)  # a fake: no adapter
    with pytest.raises(ProviderUnavailable, match="No supported adapters") as raised:
        FrameSession(models["drift-float32"], provider="webgpu")
    assert raised.value.hint.startswith("install a Vulkan driver")


# ---- CUDA, which no test machine has ---------------------------------------------------------


def test_cuda_that_is_absent_is_refused(models):
    with pytest.raises(ProviderUnavailable, match="has no CUDAExecutionProvider") as raised:
        FrameSession(models["drift-float32"], provider="cuda")
    assert "onnxruntime-gpu" in raised.value.hint


@pytest.fixture
def with_cuda(monkeypatch):
    names = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: names)  # a fake: CUDA
    return names


@pytest.mark.parametrize("capture", [True, False])
def test_cuda_is_told_to_record_a_graph(capture, models, monkeypatch, with_cuda):
    received = {}

    def remember(model, settings, inputs, **options):
        received.update(model=model, given=inputs, **options)
        return SimpleNamespace(get_providers=lambda: with_cuda)

    monkeypatch.setattr(onnxruntime, "InferenceSession", remember)  # a fake: CUDA
    open_session(models["drift-float32"], SessionOptions(choice=choose_provider(), capture=capture))
    options = {"device_id": "0", "enable_cuda_graph": "1" if capture else "0"}
    assert received == {
        "model": str(models["drift-float32"]),
        "given": [("CUDAExecutionProvider", options)],
        "enable_fallback": 0,
    }
    assert installed_providers() == ["cpu", "webgpu", "cuda"]
    assert ProviderChoice("cuda", "").device == "CUDA device 0"


@pytest.mark.filterwarnings("ignore:Specified provider 'CUDA:UserWarning")
def test_cuda_that_does_not_load_gives_way_to_the_cpu(models, with_cuda):
    """The package may be there and its libraries not: ONNX Runtime then uses the CPU silently."""
    with FrameSession(models["drift-float32"]) as session:
        assert session.provider == "cpu"
        assert session.reason == (
            "cuda failed: the session runs on CPUExecutionProvider, expected CUDAExecutionProvider"
        )
        session.run({"time": 0.5})


@pytest.fixture
def stand_in(monkeypatch, with_cuda):
    """Let the CPU stand in for CUDA: its buffers are copied to and from, its graph numbers noted."""
    make, open_plainly = onnxruntime.OrtValue.ortvalue_from_shape_and_type, open_session

    def on_the_host(shape, dtype, memory, number):
        assert (memory, number) == ("cuda", 0)
        return make(shape, dtype)

    def as_the_cpu(path, opening):
        opened.append(opening.capture)
        return open_plainly(path, SessionOptions(choice=ProviderChoice("cpu", "")))

    opened: list[bool] = []
    # A fake of CUDA's memory.
    monkeypatch.setattr(onnxruntime.OrtValue, "ortvalue_from_shape_and_type", on_the_host)
    monkeypatch.setattr(warm_up, "open_session", as_the_cpu)
    return opened


def test_the_way_of_a_frame_through_cuda_on_a_stand_in(models, stand_in):
    """All but the device: capture is asked for and checked, inputs and outputs are copied."""
    with FrameSession(models["drift-float32"], provider="cpu") as reference:
        expected = [reference.run({"time": t}, copy=True)["gaussians"] for t in (0, 1)]
    with pytest.warns(NodesOnCpu, match=r"cuda: 3 of 3 nodes run on the CPU \(Mul, Add, Concat\)"):
        opened = FrameSession(models["drift-float32"], provider="cuda")
    with opened as session:
        assert (session.provider, session.captured) == ("cuda", True)
        for time in (0, 1):
            actual = session.run({"time": time})["gaussians"]
            np.testing.assert_array_equal(actual, expected[time])
    assert stand_in[-1] is True


def test_a_stale_capture_of_cuda_is_given_up_on_a_stand_in(models, stand_in, monkeypatch):
    monkeypatch.setattr(warm_up.BoundSession, "run", lambda bound: None)  # replays nothing
    with (
        pytest.warns(NodesOnCpu),
        pytest.warns(CaptureOff, match=r"output gaussians .* frames differ"),
    ):
        FrameSession(models["drift-float32"], provider="cuda").close()
    assert stand_in[-2:] == [True, False]


def test_an_error_text_is_one_line_of_500_characters_at_most() -> None:
    text = error_text(RuntimeError("[ONNXRuntimeError] : 1 : FAIL : no\n  kernel " + "x" * 600))
    assert text == f"no kernel {'x' * 490}"
    assert error_text(RuntimeError("")) == "RuntimeError"

"""Chooses an execution provider, and opens ONNX Runtime sessions on it."""

__all__ = [
    "PROVIDERS",
    "Provider",
    "ProviderChoice",
    "SessionOptions",
    "choose_provider",
    "installed_providers",
    "open_session",
]  # fmt: skip

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, get_args

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.files_beside import require_loadable
from gsgen.contract.probing.sandbox_worker import model_source
from gsgen.sdk.binding.providers.buffers import HostMemory
from gsgen.sdk.binding.providers.cancellation import FATAL_LOG_LEVEL, Stop
from gsgen.sdk.binding.providers.errors import ProviderFallback, ProviderUnavailable
from gsgen.sdk.binding.providers.node_placement import CPU, error_text
from gsgen.sdk.binding.providers.webgpu import (
    DRIVER_HINT,
    PACKAGE,
    WEBGPU,
    Adapter,
    AdapterMissing,
    find_adapter,
)

Provider = Literal["cpu", "webgpu", "cuda"]
PROVIDERS: tuple[Provider, ...] = get_args(Provider)
CUDA = "CUDAExecutionProvider"

_NO_ADAPTER_MESSAGE = "Failed to get a WebGPU adapter"

# ONNX Runtime's names for each provider, and for the memory of its buffers.
PROVIDER_NAMES: dict[Provider, str] = {"cpu": CPU, "webgpu": WEBGPU, "cuda": CUDA}
BUFFER_MEMORY: dict[Provider, str] = {"cpu": "cpu", "webgpu": "gpu", "cuda": "cuda"}


@dataclass(frozen=True, slots=True)
class ProviderChoice:
    """The chosen execution provider and the reason for the choice."""

    provider: Provider  # the provider's name
    reason: str  # the reason, one sentence
    adapter: Adapter | None = None  # the device, if the provider is WebGPU
    is_requested: bool = False  # the caller requested this provider, so no other may replace it

    @property
    def device(self) -> str:
        """The name of the device on which ONNX Runtime computes, as text."""
        if self.adapter is None:
            return {"cpu": "CPU", "cuda": "CUDA device 0"}[self.provider]
        if not self.adapter.hardware:
            return "software driver"
        return self.adapter.name or "GPU"


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """Options for opening an ONNX Runtime session."""

    choice: ProviderChoice  # the provider
    capture: bool = False  # record commands once and replay them
    sizes: Mapping[str, int] = field(default_factory=dict)  # symbol → size of a dimension
    threads: int = 0  # threads of the CPU provider; 0 lets ONNX Runtime decide
    stop: Stop | None = None  # cancels the session's runs; optional
    host_memory: HostMemory | None = None  # allocates arrays on the host; optional

    def without_capture(self) -> "SessionOptions":
        """Copy the ONNX Runtime session options, with graph capture and replay turned off."""
        return replace(self, capture=False)

    @property
    def provider_options(self) -> dict[str, str]:
        """The options of the execution provider, named as in ONNX Runtime's documentation."""
        if self.choice.provider == "webgpu":
            # With capture, int64 is computed on the GPU anyway; without, it must be enabled.
            return {"enableGraphCapture": "1"} if self.capture else {"enableInt64": "1"}
        if self.choice.provider == "cuda":
            return {"device_id": "0", "enable_cuda_graph": str(int(self.capture))}
        return {}


def installed_providers() -> list[Provider]:
    """Return the installed execution providers, even if no device is available for them."""
    providers: list[Provider] = ["cpu"]
    if find_spec(PACKAGE) is not None:
        providers.append("webgpu")
    return [*providers, "cuda"] if _has_cuda() else providers


def choose_provider(name: str = "auto") -> ProviderChoice:
    """Return the execution provider called ``name``, or with ``auto`` the fastest available one.

    Raises:
        UnknownName: No provider has this name.
        ProviderUnavailable: The provider is not installed, or no device is available for it.
    """
    if name == "auto":
        return _choose_provider_automatically()
    if name not in PROVIDERS:
        raise UnknownName.among("provider", name, ["auto", *PROVIDERS])
    provider: Provider = next(known for known in PROVIDERS if known == name)
    if provider == "cuda" and not _has_cuda():
        message = f"the installed ONNX Runtime has no {CUDA}"
        hint = "pip install onnxruntime-gpu instead of onnxruntime, or use 'auto'"
        raise ProviderUnavailable(message, where="provider cuda", hint=hint)
    adapter = _requested_adapter() if provider == "webgpu" else None
    return ProviderChoice(provider, "requested", adapter, is_requested=True)


def _choose_provider_automatically() -> ProviderChoice:
    if _has_cuda():
        return ProviderChoice("cuda", "the installed ONNX Runtime has CUDA")
    if find_spec(PACKAGE) is None:
        return ProviderChoice("cpu", "neither CUDA nor onnxruntime-ep-webgpu is installed")
    try:
        adapter = find_adapter()
    except AdapterMissing as error:
        return ProviderChoice("cpu", error.message)
    if not adapter.hardware:
        return ProviderChoice(
            "cpu", "WebGPU has only a software driver, which is slower than the CPU provider"
        )
    return ProviderChoice("webgpu", f"WebGPU has a GPU: {adapter.name}", adapter)


def _requested_adapter() -> Adapter:
    try:
        return find_adapter()
    except AdapterMissing as error:
        raise ProviderUnavailable(
            error.message, where="provider webgpu", hint=error.hint
        ) from error


def _has_cuda() -> bool:
    import onnxruntime

    return CUDA in onnxruntime.get_available_providers()


def open_session(model: Path | bytes, session_options: SessionOptions) -> Any:
    """Return an ``onnxruntime.InferenceSession`` on the chosen provider, without fallback.

    Raises :class:`ProviderFallback` if ONNX Runtime silently opened the session on the CPU instead.
    """
    import onnxruntime

    settings = onnxruntime.SessionOptions()
    settings.log_severity_level = FATAL_LOG_LEVEL
    settings.intra_op_num_threads = session_options.threads
    settings.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
    # Between frames, its threads would keep cores busy that draw or write the last frame.
    settings.add_session_config_entry("session.force_spinning_stop", "1")
    for symbol, size in session_options.sizes.items():
        settings.add_free_dimension_override_by_name(symbol, size)
    provider = session_options.choice.provider
    providers: list[Any] | None = None
    if session_options.choice.adapter is not None:
        device = session_options.choice.adapter.device
        settings.add_provider_for_devices([device], session_options.provider_options)
    else:
        providers = [(PROVIDER_NAMES[provider], session_options.provider_options)]
    source = model if isinstance(model, bytes) else model_source(str(require_loadable(model)))
    try:
        # With fallback, a missing adapter would open a session on the CPU.
        session = onnxruntime.InferenceSession(source, settings, providers, enable_fallback=0)
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        if _NO_ADAPTER_MESSAGE not in str(error):
            raise
        where = f"provider {provider}"
        raise ProviderUnavailable(error_text(error), where=where, hint=DRIVER_HINT) from error
    if PROVIDER_NAMES[provider] not in session.get_providers():
        actual = ", ".join(session.get_providers())
        message = f"the session runs on {actual}, expected {PROVIDER_NAMES[provider]}"
        raise ProviderFallback(message, where=f"provider {provider}")
    return session

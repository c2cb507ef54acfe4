"""Choose an execution provider, and open ONNX Runtime sessions on it."""

__all__ = [
    "PROVIDERS",
    "Choice",
    "Provider",
    "SessionOptions",
    "choose",
    "installed",
    "open_session",
]

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, get_args

from gsgen.contract.errors import UnknownName
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import FellBack, ProviderUnavailable
from gsgen.sdk.binding.providers.node_placement import CPU, words
from gsgen.sdk.binding.providers.webgpu import (
    DRIVER,
    PACKAGE,
    WEBGPU,
    Adapter,
    AdapterMissing,
    find_adapter,
)

Provider = Literal["cpu", "webgpu", "cuda"]
PROVIDERS: tuple[Provider, ...] = get_args(Provider)
CUDA = "CUDAExecutionProvider"
_FATAL = 4
_NO_ADAPTER = "Failed to get a WebGPU adapter"

# The provider's own name, and ONNX Runtime's name for where its buffers are.
NAMES: dict[Provider, str] = {"cpu": CPU, "webgpu": WEBGPU, "cuda": CUDA}
MEMORY: dict[Provider, str] = {"cpu": "cpu", "webgpu": "gpu", "cuda": "cuda"}


@dataclass(frozen=True, slots=True)
class Choice:
    """A provider, and why it is this one.

    Attributes:
        provider: Its name.
        reason: One sentence.
        adapter: The device, where the provider is WebGPU.
        asked: The caller named it, so that no other will do.
    """

    provider: Provider
    reason: str
    adapter: Adapter | None = None
    asked: bool = False

    @property
    def device(self) -> str:
        """What computes, in words."""
        if self.adapter is None:
            return {"cpu": "CPU", "cuda": "CUDA device 0"}[self.provider]
        if not self.adapter.hardware:
            return "software driver"
        return self.adapter.name or "GPU"


@dataclass(frozen=True, slots=True)
class SessionOptions:
    """How a session is opened.

    Attributes:
        choice: The provider.
        capture: Commands are recorded once and replayed.
        sizes: Symbol → size of a dimension.
        threads: Threads of the CPU provider; 0 lets ONNX Runtime decide.
        stop: Ends its runs; None where nobody does.
    """

    choice: Choice
    capture: bool = False
    sizes: Mapping[str, int] = field(default_factory=dict)
    threads: int = 0
    stop: Stop | None = None

    def without_capture(self) -> "SessionOptions":
        """Return the same, for a session that computes every frame anew."""
        return replace(self, capture=False)

    @property
    def provider_options(self) -> dict[str, str]:
        """What the provider is told, as its documentation names it."""
        if self.choice.provider == "webgpu":
            # Capture computes integers of 64 bits on the GPU; a plain session is told to.
            return {"enableGraphCapture": "1"} if self.capture else {"enableInt64": "1"}
        if self.choice.provider == "cuda":
            return {"device_id": "0", "enable_cuda_graph": str(int(self.capture))}
        return {}


def installed() -> list[Provider]:
    """Return the providers that ONNX Runtime has here, whether or not there is a device."""
    found: list[Provider] = ["cpu"]
    if find_spec(PACKAGE) is not None:
        found.append("webgpu")
    return [*found, "cuda"] if _has_cuda() else found


def choose(wanted: str = "auto") -> Choice:
    """Return the provider to use: the one named, or with ``auto`` the fastest that is here.

    Raises:
        UnknownName: There is no such provider.
        ProviderUnavailable: It is not installed, or there is no device for it.
    """
    if wanted == "auto":
        return _automatic()
    if wanted not in PROVIDERS:
        raise UnknownName.among("provider", wanted, ["auto", *PROVIDERS])
    provider: Provider = next(one for one in PROVIDERS if one == wanted)
    if provider == "cuda" and not _has_cuda():
        what = f"ONNX Runtime has no {CUDA} here"
        hint = "pip install onnxruntime-gpu in place of onnxruntime, or ask for 'auto'"
        raise ProviderUnavailable(what, where="provider cuda", hint=hint)
    adapter = _asked_adapter() if provider == "webgpu" else None
    return Choice(provider, "asked for", adapter, asked=True)


def _automatic() -> Choice:
    if _has_cuda():
        return Choice("cuda", "ONNX Runtime has CUDA here")
    if find_spec(PACKAGE) is None:
        return Choice("cpu", "neither CUDA nor onnxruntime-ep-webgpu is installed")
    try:
        adapter = find_adapter()
    except AdapterMissing as error:
        return Choice("cpu", error.message)
    if not adapter.hardware:
        return Choice(
            "cpu", "WebGPU has only a software driver here, which the CPU outruns"
        )
    return Choice("webgpu", f"WebGPU has a GPU here: {adapter.name}", adapter)


def _asked_adapter() -> Adapter:
    try:
        return find_adapter()
    except AdapterMissing as error:
        raise ProviderUnavailable(
            error.message, where="provider webgpu", hint=error.hint
        ) from error


def _has_cuda() -> bool:
    import onnxruntime

    return CUDA in onnxruntime.get_available_providers()


def open_session(model: Path | bytes, opening: SessionOptions) -> Any:
    """Return an ``onnxruntime.InferenceSession`` on the chosen provider and no other.

    Raises:
        ProviderUnavailable: There is no adapter.
        FellBack: ONNX Runtime opened it on the CPU instead, which it does silently.
    """
    import onnxruntime

    settings = onnxruntime.SessionOptions()
    settings.log_severity_level = _FATAL  # errors are raised; nobody needs them twice
    settings.intra_op_num_threads = opening.threads
    settings.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
    for symbol, size in opening.sizes.items():
        settings.add_free_dimension_override_by_name(symbol, size)
    provider = opening.choice.provider
    given: list[Any] | None = None
    if opening.choice.adapter is not None:
        device = opening.choice.adapter.device
        settings.add_provider_for_devices([device], opening.provider_options)
    else:
        given = [(NAMES[provider], opening.provider_options)]
    source = model if isinstance(model, bytes) else str(model)
    try:
        # With fallback, a missing adapter would give a session on the CPU.
        session = onnxruntime.InferenceSession(source, settings, given, enable_fallback=0)
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        if _NO_ADAPTER not in str(error):
            raise
        where = f"provider {provider}"
        raise ProviderUnavailable(words(error), where=where, hint=DRIVER) from error
    if NAMES[provider] not in session.get_providers():
        what = f"wanted {NAMES[provider]}, got {', '.join(session.get_providers())}"
        raise FellBack(what, where=f"provider {provider}")
    return session

"""Opens an ONNX Runtime session with graph capture if replayed frames are right, else without.

Capture records kernels and not buffer copies, so a captured model may repeat its first frame
forever without an error. Therefore, before the first frame, two different inputs are computed
without capture, then captured and replayed, and the outputs compared.
"""

__all__ = ["WarmSession", "lock_of", "open_warm"]

import threading
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import onnx

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.onnx_facts import CONTROL_FLOW
from gsgen.sdk.binding.bound.bound_session import BoundSession, tensor_specs, translate_error
from gsgen.sdk.binding.bound.input_binding import InputBinding
from gsgen.sdk.binding.bound.model_facts import ModelFacts, Tensors
from gsgen.sdk.binding.bound.replay_check import Outputs, wrong_outputs
from gsgen.sdk.binding.bound.scene_pass import (
    ScenePassSession,
    SplitModel,
    open_scene_pass,
    split_model,
)
from gsgen.sdk.binding.providers.buffers import HostMemory
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.node_placement import CPU, Node, error_text, node_placement
from gsgen.sdk.binding.providers.selection import (
    BUFFER_MEMORY,
    Provider,
    ProviderChoice,
    SessionOptions,
    choose_provider,
    open_session,
)

# All WebGPU sessions of a process share one device, which does not support several threads.
_WEBGPU_LOCK = threading.RLock()


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmSession:
    """An ONNX Runtime session with bound buffers that has run at least once."""

    choice: ProviderChoice  # the chosen provider
    bound: BoundSession | ScenePassSession  # the session and its buffers
    ports: Mapping[str, InputBinding]  # input name → binding
    nodes: tuple[Node, ...]  # the execution provider of each node
    captured: bool  # whether frames are replayed
    cause: str = ""  # the reason why they are not; empty if they are, or if capture is off

    @property
    def provider(self) -> Provider:
        """The chosen execution provider's name."""
        return self.choice.provider

    @property
    def reason(self) -> str:
        """The reason for the chosen execution provider."""
        return self.choice.reason

    @property
    def device(self) -> str:
        """The name of the device on which ONNX Runtime computes, as text."""
        return self.choice.device


def lock_of(choice: ProviderChoice) -> AbstractContextManager[object]:
    """Return the lock for all calls of a session: that of all WebGPU sessions, or a new one."""
    return _WEBGPU_LOCK if choice.provider == "webgpu" else threading.RLock()


def open_warm(
    sources: ModelFacts,
    *,
    provider: str,
    capture: bool,
    sizes: Mapping[str, int],
    threads: int,
    stop: Stop | None,
    host_memory: HostMemory | None = None,
    before: Callable[[str], None] | None = None,
) -> WarmSession:
    """Choose a provider, and open an ONNX Runtime session on it, as ``FrameSession`` documents.

    ``host_memory`` allocates the host arrays of the session's tensors; ``before`` is called with
    the chosen provider's name before the model is loaded.
    """
    size_by_symbol, choice = sources.sizes(sizes), choose_provider(provider)
    if before is not None:
        before(choice.provider)
    session_options = SessionOptions(
        choice=choice,
        capture=capture and choice.provider != "cpu",
        sizes=size_by_symbol,
        threads=threads,
        stop=stop,
        host_memory=host_memory,
    )
    with lock_of(choice):
        return _warm_up_session(sources, session_options)


def _warm_up_session(sources: ModelFacts, session_options: SessionOptions) -> WarmSession:
    """Open an ONNX Runtime session that computes correct frames, by graph capture if possible.

    If a provider that was chosen automatically fails, the CPU is used instead.
    """
    choice = session_options.choice
    try:
        return _open_with_fallback(sources, session_options)
    except GsgenError as error:
        if choice.is_requested or choice.provider == "cpu":
            raise
        cpu = ProviderChoice("cpu", f"{choice.provider} failed: {error.message}")
        return _open_without_capture(
            sources, replace(session_options, choice=cpu, capture=False), ""
        )


def _open_with_fallback(sources: ModelFacts, session_options: SessionOptions) -> WarmSession:
    if not session_options.capture:
        return _open_without_capture(sources, session_options, "")
    try:
        warm_session = _open_uncached_session(sources, session_options)
    except GsgenError:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        warm_session = _open_without_capture(sources, replace(session_options, capture=False), "")
        return replace(warm_session, cause=_with_operators(error_text(error), warm_session.nodes))
    cause = _capture_fault(sources, warm_session)
    if not cause:
        return warm_session
    warm_session.bound.close()
    return _open_without_capture(sources, replace(session_options, capture=False), cause)


def _open_without_capture(
    sources: ModelFacts, session_options: SessionOptions, cause: str
) -> WarmSession:
    try:
        warm_session = _open_uncached_session(sources, session_options)
        warm_session.bound.run()
    except Exception as error:
        raise translate_error(error) from error
    return replace(warm_session, captured=False, cause=cause)


def _open_uncached_session(sources: ModelFacts, session_options: SessionOptions) -> WarmSession:
    split = _passes_of(sources, session_options)
    if split is not None:
        return _open_passes(sources, session_options, split)
    session = open_session(sources.path, session_options)
    inputs = [
        sources.input_binding(spec, session_options.sizes)
        for spec in tensor_specs(session.get_inputs())
    ]
    ports = {port.name: port for port in inputs}
    shapes = {port.name: port.shape for port in inputs}
    memory, host_memory = (
        BUFFER_MEMORY[session_options.choice.provider],
        session_options.host_memory,
    )
    if host_memory is not None:
        host_memory.clear()
    bound = BoundSession(
        session, shapes, _default_inputs(ports), memory, session_options.stop, host_memory
    )
    return WarmSession(
        choice=session_options.choice,
        bound=bound,
        ports=ports,
        nodes=node_placement(session),
        captured=True,
    )


def _passes_of(sources: ModelFacts, session_options: SessionOptions) -> SplitModel | None:
    """Return the scene pass and the frame pass of a model on the CPU; None where it has one pass."""
    manifest = sources.manifest
    if session_options.choice.provider != "cpu" or not isinstance(manifest, GeneratorManifest):
        return None
    if len({entry.is_of_scene for entry in manifest.inputs}) < 2:
        return None
    # A pass is opened from memory, where the names of other files would mean files anywhere.
    if open_model(sources.path).external:
        return None
    return split_model(onnx.load(sources.path, load_external_data=False), manifest)


def _open_passes(
    sources: ModelFacts, session_options: SessionOptions, split: SplitModel
) -> WarmSession:
    if session_options.host_memory is not None:
        session_options.host_memory.clear()
    ports: dict[str, InputBinding] = {}
    nodes: list[Node] = []

    def bind(model: bytes) -> BoundSession:
        session = open_session(model, session_options)
        nodes.extend(node_placement(session))
        inputs = [
            sources.input_binding(spec, session_options.sizes)
            for spec in tensor_specs(session.get_inputs())
        ]
        ports.update({port.name: port for port in inputs if port.name not in split.passed})
        return BoundSession(
            session,
            {port.name: port.shape for port in inputs},
            {port.name: port.default() for port in inputs},
            BUFFER_MEMORY[session_options.choice.provider],
            session_options.stop,
            session_options.host_memory,
        )

    return WarmSession(
        choice=session_options.choice,
        bound=open_scene_pass(split, bind),
        ports=ports,
        nodes=tuple(nodes),
        captured=True,
    )


def _default_inputs(ports: Mapping[str, InputBinding]) -> Tensors:
    return {name: port.default() for name, port in ports.items()}


def _capture_fault(sources: ModelFacts, warm_session: WarmSession) -> str:
    """Compare two frames with and without graph capture; return the fault, or an empty text."""
    probes = sources.probes(warm_session.ports.values())
    try:
        uncaptured = _frames(warm_session.bound, probes, captured=False)
    except Exception as error:
        raise translate_error(error) from error
    try:
        replayed = _frames(warm_session.bound, probes, captured=True)
        warm_session.bound.write(_default_inputs(warm_session.ports))
    except Exception as error:  # capture was refused at the first run, not at creation
        return error_text(error)
    wrong_replays = wrong_outputs(uncaptured, replayed, sources.output_origin)
    return "; ".join(f"{replay.output} {replay.actual}" for replay in wrong_replays)


def _frames(
    bound: BoundSession | ScenePassSession, probes: list[Tensors], *, captured: bool
) -> list[Outputs]:
    frames: list[Outputs] = []
    for probe in probes:
        bound.write(probe)
        if captured:
            bound.run()
        else:
            bound.run_uncaptured()
        frames.append(bound.copies())
    return frames


def _with_operators(message: str, nodes: tuple[Node, ...]) -> str:
    """Append to ONNX Runtime's message the operators that prevent graph capture."""
    control_flow_operators = [node.operator for node in nodes if node.operator in CONTROL_FLOW]
    control_flow_operators += [node.operator for node in nodes if node.provider == CPU]
    operators = ", ".join(dict.fromkeys(control_flow_operators))
    return f"{message} ({operators})" if operators else message

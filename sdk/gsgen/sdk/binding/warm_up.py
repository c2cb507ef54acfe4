"""Open a session and prove that its capture is right, or do without capture and say why.

Capture records kernels and not buffer copies, so a captured model may repeat its first frame for
ever, and nothing reports it. Two different inputs are therefore computed plainly, then captured
and replayed, and compared, before the first frame is given to anybody.
"""

__all__ = ["Ready", "get_ready"]

from collections.abc import Mapping
from dataclasses import dataclass, replace

from gsgen.contract.errors import GsgenError
from gsgen.sdk.binding.bound_session import Bound, failed, specs
from gsgen.sdk.binding.input_binding import InputBinding
from gsgen.sdk.binding.model_facts import Sources, Tensors
from gsgen.sdk.binding.providers.node_placement import CPU, Node, placement, words
from gsgen.sdk.binding.providers.selection import (
    MEMORY,
    Choice,
    SessionOptions,
    open_session,
)
from gsgen.sdk.binding.replay_check import Outputs, wrong_outputs

_CONTROL_FLOW = frozenset({"If", "Loop", "Scan"})


@dataclass(frozen=True, slots=True)
class Ready:
    """A bound session that has run.

    Attributes:
        choice: The provider that it is on.
        bound: The session and its buffers.
        ports: Its inputs by name.
        nodes: Where ONNX Runtime put each node.
        captured: Frames are replayed.
        cause: Why they are not; empty where they are, or where nobody asked.
    """

    choice: Choice
    bound: Bound
    ports: Mapping[str, InputBinding]
    nodes: tuple[Node, ...]
    captured: bool
    cause: str = ""


def get_ready(sources: Sources, opening: SessionOptions) -> Ready:
    """Open a session that gives right frames: captured if that can be, else plainly.

    Where nobody asked for the provider, the CPU stands in for one that fails.

    Raises:
        ProviderUnavailable: The provider cannot be opened.
        RunFailed: The model does not run on it.
        SizeUnknown: A dimension has no size.
    """
    choice = opening.choice
    try:
        return _best(sources, opening)
    except GsgenError as error:
        if choice.asked or choice.provider == "cpu":
            raise
        cpu = Choice("cpu", f"{choice.provider} failed: {error.message}")
        return _plain(sources, replace(opening, choice=cpu, capture=False), "")


def _best(sources: Sources, opening: SessionOptions) -> Ready:
    if not opening.capture:
        return _plain(sources, opening, "")
    try:
        ready = _open(sources, opening)
    except GsgenError:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        ready = _plain(sources, replace(opening, capture=False), "")
        return replace(ready, cause=_explained(words(error), ready.nodes))
    cause = _fault(sources, ready)
    if not cause:
        return ready
    ready.bound.close()
    return _plain(sources, replace(opening, capture=False), cause)


def _plain(sources: Sources, opening: SessionOptions, cause: str) -> Ready:
    try:
        ready = _open(sources, opening)
        ready.bound.run()
    except Exception as error:
        raise failed(error) from error
    return replace(ready, captured=False, cause=cause)


def _open(sources: Sources, opening: SessionOptions) -> Ready:
    session = open_session(sources.path, opening)
    inputs = [sources.port(one, opening.sizes) for one in specs(session.get_inputs())]
    ports = {port.name: port for port in inputs}
    shapes = {port.name: port.shape for port in inputs}
    memory = MEMORY[opening.choice.provider]
    bound = Bound(session, shapes, _defaults(ports), memory, opening.stop)
    return Ready(opening.choice, bound, ports, placement(session), captured=True)


def _defaults(ports: Mapping[str, InputBinding]) -> Tensors:
    return {name: port.default() for name, port in ports.items()}


def _fault(sources: Sources, ready: Ready) -> str:
    """Run two frames plainly, then captured; return what is wrong with the latter, or nothing."""
    probes = sources.probes(ready.ports.values())
    try:
        plain = _frames(ready.bound, probes, captured=False)
    except Exception as error:
        raise failed(error) from error
    try:
        replayed = _frames(ready.bound, probes, captured=True)
        ready.bound.write(_defaults(ready.ports))
    except Exception as error:  # refused at the first run, not at creation
        return words(error)
    wrong = wrong_outputs(plain, replayed, sources.blame)
    return "; ".join(f"{one.place} {one.actual}" for one in wrong)


def _frames(bound: Bound, probes: list[Tensors], *, captured: bool) -> list[Outputs]:
    made: list[Outputs] = []
    for probe in probes:
        bound.write(probe)
        if captured:
            bound.run()
        else:
            bound.run_plainly()
        made.append(bound.copies())
    return made


def _explained(said: str, nodes: tuple[Node, ...]) -> str:
    """Add to ONNX Runtime's refusal which operators it is about."""
    guilty = [node.operator for node in nodes if node.operator in _CONTROL_FLOW]
    guilty += [node.operator for node in nodes if node.provider == CPU]
    named = ", ".join(dict.fromkeys(guilty))
    return f"{said} ({named})" if named else said

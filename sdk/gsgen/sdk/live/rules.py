"""Rules GB011 to GB017: WebGPU, with graph capture and replay, computes the same as the CPU.

Registered in the entry point group ``gsgen.rules``; the module imports nothing heavy.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import TYPE_CHECKING

from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend, LevelContext
from gsgen.contract.validation.rule import rule

if TYPE_CHECKING:
    from gsgen.sdk.live.level import LiveLevel


def _prepare_live_level(probe_runs: ProbeRuns) -> AbstractContextManager[LevelContext]:
    from gsgen.sdk.live.level import prepare_live

    return prepare_live(probe_runs)


LIVE_BACKEND = LevelBackend(Level.LIVE, "replaying frames in WebGPU", _prepare_live_level)

_EXPECTED_RUN_TEXT = "every frame of several, with inputs that change"
_live_rule = partial(rule, over="live", kinds=MANIFEST_KINDS)


@_live_rule("GB011", Severity.ERROR, needs=("GB017", "GV001"))
def ep_agreement(live: "LiveLevel") -> Iterator[Violation]:
    """The outputs of the WebGPU provider equal those of the CPU, within the model's tolerances.

    Why:
        The model is checked on the CPU and shown by a GPU, whose kernels round differently,
        truncate 64-bit integers to 32 bits, and may be wrong.

    Hint:
        Replace the operator that differs; keep integers small, and arguments of Sin and Cos within
        a few turns. Widen the manifest's "tolerances" only if the difference cannot be seen.
    """
    from gsgen.sdk.live.comparison import disagreements

    for location, actual, expected in disagreements(live):
        yield Violation.at(location, actual, expected)


@_live_rule("GB014", Severity.WARNING, needs=("GB017", "GB015"))
def capture_accepted(live: "LiveLevel") -> Iterator[Violation]:
    """ONNX Runtime's WebGPU provider agrees to capture the graph.

    Why:
        Without capture, every kernel is launched again in every frame, which takes longer than the
        kernels of a small model.

    Hint:
        Remove If, Loop and Scan, and any operator that ONNX Runtime's message names.
    """
    if not live.is_capture_accepted:
        yield Violation.at("graph", live.refusal or live.state, "a session that captures")


@_live_rule("GB015", Severity.WARNING, needs=("GB017",))
def all_nodes_on_gpu(live: "LiveLevel") -> Iterator[Violation]:
    """The WebGPU provider runs every node; no node runs on the CPU.

    Why:
        One node on the CPU costs a round trip through memory in every frame, and makes ONNX Runtime
        refuse to capture the graph.

    Hint:
        Write the operation with operators that have WebGPU kernels at this operator set: Round as
        Floor and Where, Sign as Where, 64-bit integers as 32-bit ones, and export at operator set 18.
    """
    from gsgen.sdk.binding.providers.webgpu import WEBGPU

    cpu_nodes = [node for node in live.nodes or () if node.provider != WEBGPU]
    for operator in dict.fromkeys(node.operator for node in cpu_nodes):
        first_node, *similar_nodes = [node for node in cpu_nodes if node.operator == operator]
        count = f", and {len(similar_nodes)} more like it" if similar_nodes else ""
        location = f"node {first_node.name or operator} ({operator})"
        actual = f"runs in {first_node.provider}{count}"
        yield Violation.at(location, actual, "a kernel in the WebGPU provider")


@_live_rule("GB016", Severity.ERROR, needs=("GB014",))
def replay_not_stale(live: "LiveLevel") -> Iterator[Violation]:
    """Frames replayed by graph capture equal uncaptured frames for the same inputs.

    Why:
        Capture records kernels, not buffer copies, so an output that an operator merely copies
        repeats the first frame forever. 64-bit integers are truncated to 32 bits. Scatter updates
        in place, and meets the values of the previous frame. No error reports any of this.

    Hint:
        End the output on an operator that computes, such as Mul by one; replace Scatter by Concat,
        Where or Gather; keep integers below 2147483648. `gsgen export` ends outputs in this way.
    """
    from gsgen.sdk.live.comparison import wrong_replays

    for replay in wrong_replays(live):
        yield Violation.at(
            replay.output, replay.actual, "the output of the session without capture"
        )


@_live_rule("GB017", Severity.ERROR, needs=("GV025",))
def runs_on_webgpu(live: "LiveLevel") -> Iterator[Violation]:
    """ONNX Runtime's WebGPU provider runs the model to the end.

    Why:
        Limits of a GPU only take effect when a kernel is launched: a Split into more outputs than a
        stage has storage buffers, or a tensor larger than a buffer. Viewers then show nothing.

    Hint:
        Split wide operators and large tensors; the rule pages GG007 and GL001 give the limits.
    """
    stop = live.stop
    if stop is not None and not live.refusal:
        stop_text = "at the creation of the session" if stop.frame < 0 else f"in frame {stop.frame}"
        actual = f"stopped {stop_text} ({stop.phase} session): {stop.message}"
        yield Violation.at("graph", actual, _EXPECTED_RUN_TEXT)

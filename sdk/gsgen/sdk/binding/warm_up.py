"""Open a session and prove that its capture is right, or do without capture and say why.

Capture records kernels and not buffer copies, so a captured model may repeat its first frame for
ever, and nothing reports it. Two different inputs are therefore computed plainly, then captured
and replayed, and compared, before the first frame is given to anybody.
"""

__all__ = ["Ready", "Sources", "get_ready", "read_sources", "two_probes"]

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.graph import Graph, read_graph
from gsgen.contract.manifest import GeneratorManifest, Manifest
from gsgen.contract.model import ModelFile, open_model
from gsgen.contract.probes import default_probes
from gsgen.sdk.binding.bound import Bound, failed, specs
from gsgen.sdk.binding.placed import CPU, Node, placement, words
from gsgen.sdk.binding.port import Port
from gsgen.sdk.binding.providers import MEMORY, Opening, open_session
from gsgen.sdk.binding.replay import maker, wrong_outputs

# Of this many probes, two are used that differ even where time loops.
_PROBES, _CHOSEN = 4, (1, 3)
_CONTROL_FLOW = frozenset({"If", "Loop", "Scan"})

Tensors = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Sources:
    """The model, and what is known of it before it runs.

    Attributes:
        path: The ONNX file.
        file: Its structure.
        manifest: What its tensors mean; None where nobody says.
    """

    path: Path
    file: ModelFile
    manifest: Manifest | None

    @cached_property
    def graph(self) -> Graph:
        """The graph, read when something has to be explained."""
        return read_graph(self.file)

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of symbols, as far as the manifest's shapes of inputs give them."""
        declared = (
            {i.name: i.shape for i in self.manifest.inputs if i.shape}
            if self.manifest
            else {}
        )
        found: dict[str, int] = {}
        for value in self.file.proto.graph.input:
            dims = value.type.tensor_type.shape.dim
            for axis, size in enumerate(declared.get(value.name, ())):
                if axis < len(dims) and not dims[axis].HasField("dim_value"):
                    key = dims[axis].dim_param or f"{value.name}[{axis}]"
                    found.setdefault(key, size)
        return found

    def blame(self, output: str) -> str:
        """Say where an output comes from."""
        return maker(self.graph, output)


@dataclass(frozen=True, slots=True)
class Ready:
    """A bound session that has run.

    Attributes:
        bound: The session and its buffers.
        ports: Its inputs by name.
        nodes: Where ONNX Runtime put each node.
        captured: Frames are replayed.
        cause: Why they are not; empty where they are.
    """

    bound: Bound
    ports: Mapping[str, Port]
    nodes: tuple[Node, ...]
    captured: bool
    cause: str


def get_ready(sources: Sources, opening: Opening) -> Ready:
    """Open a session that gives right frames: captured if that can be, else plainly.

    Raises:
        ProviderUnavailable: The provider cannot be opened.
        RunFailed: The model does not run on it.
        SizeUnknown: A dimension has no size.
    """
    if not opening.capture:
        return _plain(sources, opening, "")
    try:
        ready = _open(sources, opening)
    except GsgenError:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        ready = _plain(sources, opening.without_capture(), "")
        return _with_cause(ready, _explained(words(error), ready.nodes))
    cause = _fault(sources, ready)
    if not cause:
        return ready
    ready.bound.close()
    return _plain(sources, opening.without_capture(), cause)


def _plain(sources: Sources, opening: Opening, cause: str) -> Ready:
    try:
        ready = _open(sources, opening)
        ready.bound.run()
    except Exception as error:
        raise failed(error) from error
    return _with_cause(ready, cause)


def _with_cause(ready: Ready, cause: str) -> Ready:
    return Ready(ready.bound, ready.ports, ready.nodes, captured=False, cause=cause)


def _open(sources: Sources, opening: Opening) -> Ready:
    session = open_session(sources.path, opening)
    ports = {
        one.name: Port(
            one.name,
            one.dtype,
            one.shape(opening.sizes),
            _declared(sources.manifest, one.name),
            _order(sources.manifest),
        )
        for one in specs(session.get_inputs())
    }
    shapes = {name: port.shape for name, port in ports.items()}
    start = {name: port.default() for name, port in ports.items()}
    bound = Bound(session, shapes, start, MEMORY[opening.choice.provider])
    return Ready(bound, ports, placement(session), captured=True, cause="")


def _fault(sources: Sources, ready: Ready) -> str:
    """Run two frames plainly, then captured; return what is wrong with the latter, or nothing."""
    bound = ready.bound
    start = {name: port.default() for name, port in ready.ports.items()}
    try:
        plain = []
        probes = two_probes(sources.manifest, ready.ports)
        for probe in probes:
            bound.write(probe)
            bound.run_plainly()
            plain.append(bound.copies())
    except Exception as error:
        raise failed(error) from error
    try:
        replayed = []
        for probe in probes:
            bound.write(probe)
            bound.run()
            replayed.append(bound.copies())
        bound.write(start)
    except Exception as error:  # refused at the first run, not at creation
        return words(error)
    wrong = list(wrong_outputs(plain, replayed, sources.blame))
    return "; ".join(f"{one.place} {one.saw}" for one in wrong)


def two_probes(manifest: Manifest | None, ports: Mapping[str, Port]) -> list[Tensors]:
    """Return two sets of inputs that differ; the manifest's probes, or numbers in [0, 1]."""
    if manifest is not None and {i.name for i in manifest.inputs} == set(ports):
        shapes = {name: port.shape for name, port in ports.items()}
        dtypes = {name: port.dtype.name for name, port in ports.items()}
        probes = default_probes(manifest, shapes, dtypes, count=_PROBES)
        return [probes[min(k, len(probes) - 1)].inputs for k in _CHOSEN]
    rng = np.random.default_rng(0)
    return [
        {
            name: np.asarray(rng.random(port.shape) * (k + 1)).astype(port.dtype)
            for name, port in ports.items()
        }
        for k in range(2)
    ]


def _explained(said: str, nodes: tuple[Node, ...]) -> str:
    """Add to ONNX Runtime's refusal which operators it is about."""
    operators = [node.operator for node in nodes]
    guilty = [op for op in operators if op in _CONTROL_FLOW]
    guilty += [node.operator for node in nodes if node.provider == CPU]
    named = ", ".join(dict.fromkeys(guilty))
    return f"{said} ({named})" if named else said


def _declared(manifest: Manifest | None, name: str) -> Any:
    return next((i for i in manifest.inputs if i.name == name), None) if manifest else None


def _order(manifest: Manifest | None) -> str:
    space = manifest.space if isinstance(manifest, GeneratorManifest) else None
    return space.matrix_order if space else "column"


def read_sources(path: Path, manifest: Manifest | None) -> Sources:
    """Open a model's structure, and read its manifest unless one is given.

    Raises:
        ModelUnreadable: The file is no ONNX model.
        ManifestInvalid: The embedded manifest cannot be read.
    """
    from gsgen.contract.manifest_json import loads

    file = open_model(path)
    if manifest is None and file.manifest_text is not None:
        manifest = loads(file.manifest_text)
    return Sources(path, file, manifest)

"""A model's session in a confined process, with the model's tensors in shared memory."""

__all__ = ["ConfinedSession", "open_confined"]

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, cast, final

import numpy as np

from gsgen.contract.spec.manifest_io import dumps
from gsgen.sdk.binding.bound.bound_session import TensorSpec
from gsgen.sdk.binding.bound.model_facts import ModelFacts
from gsgen.sdk.binding.confined.messages import Message
from gsgen.sdk.binding.confined.models import Channel, ConfinedModels
from gsgen.sdk.binding.confined.shared_arrays import SharedArraySlot
from gsgen.sdk.binding.providers.buffers import Buffer, read_only, same_bits
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import RunFailed
from gsgen.sdk.binding.providers.node_placement import Node
from gsgen.sdk.binding.providers.selection import PROVIDERS, Provider


@final
class _SharedBuffer(Buffer):
    """A tensor in memory that the process which computes it shares."""

    def __init__(self, array: np.ndarray) -> None:
        super().__init__(array.shape, array.dtype)
        self._array, self._view = array, read_only(array)

    @property
    def value(self) -> Any:
        """Raise: ONNX Runtime's handle is in another process.

        Raises:
            RunFailed: Always.
        """
        hint = "Open the session without confined=, or read the output as an array."
        raise RunFailed("a confined session has no OrtValue", where="output", hint=hint)

    @property
    def host(self) -> np.ndarray:
        """The tensor's array in shared memory."""
        return self._array

    def upload(self) -> None:
        """Do nothing: the other process copies the tensor to its device."""

    def write(self, array: np.ndarray) -> bool:
        """Copy an array into the tensor's shared memory."""
        if same_bits(self._array, array):
            return False
        self._array[...] = array
        return True

    def read(self) -> np.ndarray:
        """Return the tensor in shared memory, without a copy."""
        return self._view


@final
class ConfinedSession:
    """A model that a confined process runs; its inputs and outputs are in shared memory.

    Attributes:
        ports: Input name → binding.
        outputs: Output name → buffer.
        provider: The execution provider.
        reason: The reason for this provider.
        device: The device that computes, as text.
        captured: Whether frames are replayed.
        cause: The reason why they are not; empty if they are, or if capture is off.
        nodes: The execution provider of each node.
    """

    def __init__(self, sources: ModelFacts, channel: Channel, facts: Message) -> None:
        self._channel = channel
        self._inputs = self._buffers(facts["inputs"])
        self.outputs: Mapping[str, Buffer] = MappingProxyType(self._buffers(facts["outputs"]))
        self.ports = {
            name: sources.input_binding(TensorSpec(name, buffer.dtype, buffer.shape), {})
            for name, buffer in self._inputs.items()
        }
        if facts["provider"] not in PROVIDERS:
            raise RunFailed("the process that runs the model names no provider")
        self.provider = cast("Provider", facts["provider"])
        self.reason, self.device = str(facts["reason"]), str(facts["device"])
        self.captured, self.cause = bool(facts["captured"]), str(facts["cause"])
        self.nodes = tuple(Node(*map(str, node)) for node in facts["nodes"])
        self._changed_inputs: set[str] = set()
        self._read_outputs: set[str] = set()

    def _buffers(self, places: Mapping[str, Any]) -> dict[str, Buffer]:
        return {
            name: _SharedBuffer(
                self._channel.shared.array_at(
                    SharedArraySlot(int(offset), tuple(map(int, shape)), np.dtype(str(dtype)))
                )
            )
            for name, (offset, shape, dtype) in places.items()
        }

    def write(self, tensors: Mapping[str, np.ndarray]) -> frozenset[str]:
        """Copy tensors into the session's inputs; return the names of changed model inputs."""
        changed = [name for name, array in tensors.items() if self._inputs[name].write(array)]
        self._changed_inputs.update(changed)
        return frozenset(changed)

    def run(self) -> None:
        """Compute a frame."""
        self._read_outputs.clear()
        self._channel.run(self._changed_inputs)
        self._changed_inputs.clear()

    def read(self, name: str) -> np.ndarray:
        """Return a model output as a read-only array, copied from the device once per frame."""
        if self.provider != "cpu" and name not in self._read_outputs:
            self._channel.ask({"read": name}, "an output")
            self._read_outputs.add(name)
        return self.outputs[name].read()

    def copies(self) -> dict[str, np.ndarray]:
        """Return copies of all model outputs, by output name."""
        return {name: self.read(name).copy() for name in self.outputs}

    def close(self) -> None:
        """End the session in the other process."""
        self._channel.close()


def open_confined(
    sources: ModelFacts,
    models: ConfinedModels,
    *,
    provider: str,
    capture: bool,
    sizes: Mapping[str, int],
    threads: int,
    stop: Stop | None,
    is_embedded: bool,
) -> ConfinedSession:
    """Open a session in a confined process, as ``FrameSession`` documents.

    ``is_embedded`` says that the model file holds the manifest.
    """
    manifest = None if is_embedded or sources.manifest is None else dumps(sources.manifest)
    request = {
        "provider": provider,
        "capture": capture,
        "sizes": dict(sources.sizes(sizes)),
        "threads": threads,
        "manifest": manifest,
    }
    channel = models.open(sources.file, request)
    try:
        if stop is not None:
            channel.follow(stop)
        facts = channel.ask(None, "loading the model")
        return ConfinedSession(sources, channel, facts)
    except BaseException:
        channel.close()
        raise

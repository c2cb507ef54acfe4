"""One mutant: which model, which mutations, which settings, all of it decided by two numbers."""

__all__ = ["Case", "draw"]

import random
from collections.abc import Sequence
from dataclasses import dataclass

from google.protobuf.message import DecodeError, EncodeError
from onnx import ModelProto

from fuzz.corpus import Base
from fuzz.mutations import mutate_bytes, mutate_manifest, mutate_model
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.severity import Level

_MANIFEST_SHARE, _BYTES_SHARE = 0.3, 0.15
_TARGETS = ("core", "webgpu", "visionary", "gsgen")
_COMMAND_SHARE, _BEHAVIOUR_SHARE = 0.01, 0.05


@dataclass(frozen=True, slots=True)
class Case:
    """A mutant and how to judge it.

    Attributes:
        seed: Seed of the whole run.
        index: Number of the case within it.
        base: The model it was made from.
        mutations: Names of what was done to it, in order.
        content: Bytes of the file.
        target: What it is judged for.
        command: It goes through the command line in a process of its own.
        level: How far judging goes.
    """

    seed: int
    index: int
    base: Base
    mutations: tuple[str, ...]
    content: bytes
    target: str
    command: bool
    level: Level = Level.VALUES


def draw(seed: int, index: int, corpus: Sequence[Base]) -> Case:
    """Make case ``index`` of the run ``seed``; the same on every machine."""
    rng = random.Random(f"{seed}/{index}")
    base = rng.choice(corpus)
    names: list[str] = []
    content = _mutated(base.content, rng, names)
    target = base.target if rng.random() < 0.6 else rng.choice(_TARGETS)
    mutation_choice = rng.random()
    command = mutation_choice < _COMMAND_SHARE
    level = Level.BEHAVIOUR if mutation_choice > 1 - _BEHAVIOUR_SHARE else Level.VALUES
    return Case(seed, index, base, tuple(names), content, target, command, level)


def _mutated(content: bytes, rng: random.Random, names: list[str]) -> bytes:
    choice = rng.random()
    if choice < _BYTES_SHARE:
        return _bytes_mutated(content, rng, names)
    model = ModelProto.FromString(content)
    if choice < _BYTES_SHARE + _MANIFEST_SHARE:
        _mutate_manifest(model, rng, names)
    if choice >= _BYTES_SHARE + _MANIFEST_SHARE or rng.random() < 0.1:
        for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
            mutation = rng.choice(mutate_model.MUTATIONS)
            _try(mutation, model, rng, names)
    return _serialized(model)


def _bytes_mutated(content: bytes, rng: random.Random, names: list[str]) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 4))):
        mutation = rng.choice(mutate_bytes.MUTATIONS)
        content = mutation(content, rng) or b"\0"
        names.append(f"bytes.{mutation.__name__}")
    return content


def _mutate_manifest(model: ModelProto, rng: random.Random, names: list[str]) -> None:
    entry = next((prop for prop in model.metadata_props if prop.key == MANIFEST_KEY), None)
    if entry is None:
        entry = model.metadata_props.add(key=MANIFEST_KEY, value='{"contract": "1.0"}')
    text = entry.value
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        mutation = rng.choice(mutate_manifest.MUTATIONS)
        text = mutation(text, rng)
        names.append(f"manifest.{mutation.__name__}")
    entry.value = text.encode("utf-8", "replace").decode()  # protobuf has no lone surrogates


def _try(
    mutation: mutate_model.Mutation, model: ModelProto, rng: random.Random, names: list[str]
) -> None:
    """Mutate; where protobuf itself cannot hold what was wanted, leave the model as it is."""
    before = ModelProto()
    before.CopyFrom(model)
    try:
        mutation(model, rng)
        model.SerializeToString()
        names.append(mutation.__name__)
    except (ValueError, EncodeError, DecodeError, RecursionError):
        model.CopyFrom(before)
        names.append(f"{mutation.__name__}!")


def _serialized(model: ModelProto) -> bytes:
    return model.SerializeToString() or b"\0"

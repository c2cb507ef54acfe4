"""What a model of the set is, and what a validator should say of it."""

__all__ = [
    "Draft",
    "Fault",
    "RightModel",
    "Sentence",
    "all_faults",
    "all_right_models",
    "fault",
    "right_model",
]

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from onnx import ModelProto


@dataclass(frozen=True, slots=True)
class Draft:
    """A model before it is written.

    Attributes:
        proto: The model, without its manifest.
        manifest: The manifest as an object, as text that is stored as it is, or None.
        files: Files that lie beside the model, by relative path.
    """

    proto: ModelProto
    manifest: dict[str, Any] | str | None = None
    files: dict[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of the specification, which a test looks up there."""

    page: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A faulty model.

    Attributes:
        name: Unique name of the model.
        family: The family of mistakes.
        mistake: What the person did, in one sentence.
        sentence: The sentence of the specification that is violated; None where only the
            picture shows the fault.
        cause: Regular expressions; the first finding's text should match one of them.
        target: The target that it is judged for.
        level: The lowest level that can notice it.
        checker: Whether ``onnx.checker`` accepts the model.
        loads: Whether ONNX Runtime creates a session of it.
        build: Makes the model.
    """

    name: str
    family: str
    mistake: str
    sentence: Sentence | None
    cause: tuple[str, ...]
    target: str = "core"
    level: str = "behaviour"
    checker: bool = True
    loads: bool = True
    build: Callable[[], Draft]

    @property
    def decidable(self) -> bool:
        """Whether a sentence of the specification is violated."""
        return self.sentence is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class RightModel:
    """A model without a fault.

    Attributes:
        name: Unique name of the model.
        tool: What made the file.
        kind: Surface, hair, cloud, room, avatar, or a companion kind.
        statistics: Whether its numbers look trained or synthetic.
        target: The target that it is judged for.
        warnings: Rules that each warn once: the model does what the specification allows and
            these rules advise against.
        build: Makes the model.
    """

    name: str
    tool: str
    kind: str
    statistics: str
    target: str = "core"
    warnings: tuple[str, ...] = ()
    build: Callable[[], Draft]


_FAULTS: dict[str, Fault] = {}
_RIGHT_MODELS: dict[str, RightModel] = {}


def fault(
    name: str,
    family: str,
    mistake: str,
    *cause: str,
    build: Callable[[], Draft],
    sentence: Sentence | None = None,
    target: str = "core",
    level: str = "behaviour",
    checker: bool = True,
    loads: bool = True,
) -> None:
    """Add a faulty model to the set.

    Raises:
        ValueError: The name is taken.
    """
    if name in _FAULTS:
        raise ValueError(f"two faulty models are called {name}")
    _FAULTS[name] = Fault(
        name=name,
        family=family,
        mistake=mistake,
        sentence=sentence,
        cause=cause,
        target=target,
        level=level,
        checker=checker,
        loads=loads,
        build=build,
    )


def right_model(
    name: str,
    tool: str,
    kind: str,
    statistics: str,
    *,
    build: Callable[[], Draft],
    target: str = "core",
    warnings: tuple[str, ...] = (),
) -> None:
    """Add a right model to the set.

    Raises:
        ValueError: The name is taken.
    """
    if name in _RIGHT_MODELS:
        raise ValueError(f"two right models are called {name}")
    _RIGHT_MODELS[name] = RightModel(
        name=name,
        tool=tool,
        kind=kind,
        statistics=statistics,
        target=target,
        warnings=warnings,
        build=build,
    )


def all_faults() -> tuple[Fault, ...]:
    """Return every faulty model, family by family."""
    _load("contract.adversarial.faults")
    _load("contract.adversarial.later_faults")
    return tuple(_FAULTS.values())


def all_right_models() -> tuple[RightModel, ...]:
    """Return every right model, tool by tool."""
    _load("contract.adversarial.right")
    return tuple(_RIGHT_MODELS.values())


def _load(package: str) -> None:
    folder = importlib.import_module(package)
    for module in pkgutil.iter_modules(folder.__path__):
        importlib.import_module(f"{package}.{module.name}")

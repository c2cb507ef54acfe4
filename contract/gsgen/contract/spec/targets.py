"""Validation targets: versioned data files with the limits and quirks of runtimes and viewers."""

__all__ = ["Target", "TargetUnusable", "known_targets", "load_target", "target_from_json"]

import json
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from importlib.metadata import EntryPoint
from typing import Any, ClassVar, Final

from gsgen.contract._entry_points import plugin_exits_as_errors, registered_entry_points, short_repr
from gsgen.contract.errors import ConfigInvalid, ExitCode, UnknownName
from gsgen.contract.spec.severity import Severity

# Target → words that people type for it.
_TARGET_WORDS: Final = {
    "core": "onnxruntime ort onnx default any cpu native all",
    "webgpu": "web browser chrome firefox wgpu gpu onnxruntime-web ort-web",
    "gsgen": "viewer renderer runtime",
}


class TargetUnusable(ConfigInvalid):
    """Raised if the definition that a package registers under ``gsgen.targets`` does not load."""

    exit_code: ClassVar[int] = ExitCode.INTERNAL


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The limits of one runtime or viewer that models are validated for.

    Attributes:
        name: What ``--target`` takes.
        version: Version of the data file.
        summary: One sentence for people.
        opset: Lowest and highest ONNX operator set.
        ir: Highest ONNX IR version.
        domains: Operator domains it has kernels for.
        limits: Name → number, such as ``binding_bytes``.
        follows_runtime: Whether models may have any operator set and IR version that the installed
            ONNX Runtime loads, above those of the data file, too.
        operators: Names of the operator tables of the releases that it runs on; empty if
            unknown.
        severities: Rule id → severity that differs from the rule's own.
    """

    name: str
    version: str
    summary: str
    opset: tuple[int, int]
    ir: int
    domains: frozenset[str]
    limits: dict[str, int] = field(default_factory=dict)
    severities: dict[str, Severity] = field(default_factory=dict)
    operators: tuple[str, ...] = ()
    follows_runtime: bool = False

    @property
    def runs_natively(self) -> bool:
        """Whether running a model in the native WebGPU backend shows what this target supports."""
        return not self.operators or any(name.startswith("ep-") for name in self.operators)

    @property
    def label(self) -> str:
        """The name and version of the target runtime, as validation reports show them."""
        return f"{self.name}@{self.version}"


def target_from_json(text: str, where: str) -> Target:
    """Parse the JSON data file that defines a target runtime or viewer.

    Raises:
        ConfigInvalid: It is not such a file.
    """
    try:
        data = json.loads(text)
        return Target(
            name=data["name"],
            version=data["version"],
            summary=data["summary"],
            opset=(data["opset"][0], data["opset"][1]),
            ir=data["ir"],
            domains=frozenset(data["domains"]),
            limits=data.get("limits", {}),
            severities={k: Severity.parse(v) for k, v in data.get("severities", {}).items()},
            operators=tuple(data.get("operators", ())),
            follows_runtime=data.get("follows_runtime", False),
        )
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise ConfigInvalid(
            f"the file does not define a target runtime or viewer: {error!r}", where=where
        ) from error


@cache
def _contract_targets() -> dict[str, Target]:
    """Return the definitions of target runtimes and viewers that are part of gsgen."""
    folder = resources.files("gsgen.contract").joinpath("targets_data")
    files = sorted(folder.iterdir(), key=lambda entry: entry.name)
    targets = [
        target_from_json(file.read_text("utf-8"), file.name)
        for file in files
        if file.name.endswith(".json")
    ]
    return {target.name: target for target in targets}


@cache
def known_targets() -> dict[str, Target]:
    """Return every installed definition of a target runtime by name; third parties' come last.

    A third party registers a :class:`Target`, or a function without arguments that returns one,
    under the entry point group ``gsgen.targets``. It may build on ours with :func:`load_target`.

    Raises:
        TargetUnusable: A registered target cannot be loaded.
    """
    targets = dict(_contract_targets())
    for point in registered_entry_points("gsgen.targets"):
        target = _load_entry_point(point)
        targets[target.name] = target
    return targets


def _load_entry_point(point: EntryPoint) -> Target:
    where = f"target {point.name} = {point.value}"
    try:
        with plugin_exits_as_errors():
            loaded_target: Any = point.load()
            target = loaded_target() if callable(loaded_target) else loaded_target
    except Exception as error:  # a third party's code may fail in any way
        message = f"the target runtime's definition cannot be loaded: {short_repr(error)}"
        raise TargetUnusable(message, where=where) from error
    if not isinstance(target, Target):
        message = f"the entry point returns {short_repr(target)}, expected a Target"
        raise TargetUnusable(message, where=where)
    return target


def load_target(name: str, where: str = "--target") -> Target:
    """Return the definition of the target runtime called ``name`` or ``name@version``.

    Raises:
        UnknownName: No target has that name.
        ConfigInvalid: The target has another version.
    """
    base_name, _, version = name.partition("@")
    contract_targets = _contract_targets()
    base_name = base_name.lower() if base_name.lower() in contract_targets else base_name
    targets = contract_targets if base_name in contract_targets else known_targets()
    if base_name not in targets:
        raise UnknownName.among("target", base_name, targets, where, _TARGET_WORDS)
    target = targets[base_name]
    if version and version != target.version:
        raise ConfigInvalid(
            f"validation target {base_name} has version {target.version}, not {version}",
            where=where,
        )
    return target

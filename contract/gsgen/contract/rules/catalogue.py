"""The installed rules: those of the contract, and those that other packages register."""

__all__ = ["RULE_FAMILIES", "builtin_rules", "installed_rules"]

import re
import traceback
from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

from gsgen.contract._entry_points import plugin_exits_as_errors, registered_entry_points, short_repr
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.rules import safety, waivers
from gsgen.contract.rules.behaviour import (
    camera,
    determinism,
    motion,
    recorded_vectors,
    robustness,
    root,
    skeleton,
    survey,
    trajectory,
)
from gsgen.contract.rules.graph import capture, graph, naming, repeatability
from gsgen.contract.rules.interface import (
    avatar_inputs,
    declarations,
    extensions,
    input_declarations,
    inputs,
    manifest,
    scene_inputs,
    side_files,
    units,
)
from gsgen.contract.rules.outputs import capacity, companions, graph_outputs, outputs
from gsgen.contract.rules.pictures import (
    colors,
    effects,
    harmonics,
    opacities,
    orientation,
    poses,
    resolution,
    sizes,
    source_pictures,
    turning,
)
from gsgen.contract.rules.targets import limits, visionary, visionary_drawing
from gsgen.contract.rules.values import (
    appearance,
    camera_space,
    cells,
    covariance,
    execution,
    extent,
    rows,
)
from gsgen.contract.rules.values import companions as companion_values
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend
from gsgen.contract.validation.rule import Registry, Rule, backends_in, rule, rules_in

RULE_FAMILIES = (
    manifest,
    declarations,
    extensions,
    inputs,
    input_declarations,
    avatar_inputs,
    scene_inputs,
    units,
    outputs,
    companions,
    graph_outputs,
    graph,
    repeatability,
    capture,
    naming,
    rows,
    execution,
    camera_space,
    companion_values,
    covariance,
    extent,
    appearance,
    cells,
    sizes,
    orientation,
    opacities,
    colors,
    harmonics,
    resolution,
    determinism,
    camera,
    motion,
    root,
    robustness,
    recorded_vectors,
    skeleton,
    survey,
    trajectory,
    turning,
    effects,
    source_pictures,
    poses,
    limits,
    capacity,
    safety,
    side_files,
    visionary,
    visionary_drawing,
    waivers,
)


def builtin_rules() -> list[Rule]:
    """Return gsgen's own validation rules, sorted by family and id."""
    rules = [entry for module in RULE_FAMILIES for entry in rules_in(module)]
    order = list(dict.fromkeys(entry.family for entry in rules))
    return sorted(rules, key=lambda entry: (order.index(entry.family), entry.id))


@cache
def installed_rules() -> Registry:
    """Return the built-in rules and those that packages register under ``gsgen.rules``.

    An entry point names a module that defines rules and level backends, or a list of them. An
    entry point that does not load becomes a crashed rule in every report. gsgen's rules of
    tilesets are in ``gsgen.tiles.all_rules``.
    """
    rules = builtin_rules()
    backends: list[LevelBackend] = []
    for number, point in enumerate(registered_entry_points("gsgen.rules")):
        try:
            with plugin_exits_as_errors():
                loaded_rules, loaded_backends = _load(point)
                # Raises if an id or a level is already taken.
                Registry.from_rules([*rules, *loaded_rules], [*backends, *loaded_backends])
                _require_rule_owner(point, loaded_rules)
        except Exception as error:  # a third party's import may fail in any way
            loaded_rules, loaded_backends = [_unloadable_rule(point, number, error)], []
        rules.extend(loaded_rules)
        backends.extend(loaded_backends)
    return Registry.from_rules(rules, backends)


def _require_rule_owner(point: EntryPoint, rules: list[Rule]) -> None:
    """Raise if a package other than gsgen registers an id without a name in front."""
    if point.value.partition(".")[0] == "gsgen":
        return
    for entry in rules:
        if "/" not in entry.id:
            raise ValueError(
                f"rule {entry.id} has no name in front, expected {point.name}/{entry.id}"
            )


def _unloadable_rule(point: EntryPoint, number: int, error: Exception) -> Rule:
    """Return a rule that always crashes, to report that a plugin's rules cannot be loaded."""
    name_letters = re.sub("[^a-z0-9]+", "-", point.name.lower()).lstrip("-0123456789")

    @rule(f"{name_letters or 'plugin'}/XX{number:03}", Severity.ERROR, kinds=MANIFEST_KINDS)
    def plugin_loads(_: InspectedModel) -> Iterator[Violation]:
        """The rules of every installed plugin can be loaded.

        Why:
            Rules that do not load would be left out, and the report would look better than it is.

        Hint:
            Repair or uninstall the package that registers them.
        """
        message = f"rules {point.name} = {point.value} do not load: {short_repr(error)}"
        raise ImportError(f"{message}{_location_text(error)}")

    return plugin_loads


def _location_text(error: BaseException) -> str:
    """Return the file and line of a plugin's code that raised an error, if its code ran."""
    contract_folder = str(Path(__file__).parents[1])
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        is_import = frame.filename.startswith("<") or "importlib" in Path(frame.filename).parts
        if not is_import and not frame.filename.startswith(contract_folder):
            return f", at {Path(frame.filename).name}:{frame.lineno} ({frame.line})"
    return ""


def _load(point: EntryPoint) -> tuple[list[Rule], list[LevelBackend]]:
    plugin = point.load()
    if isinstance(plugin, ModuleType):
        return rules_in(plugin), backends_in(plugin)
    backends = [entry for entry in plugin if isinstance(entry, LevelBackend)]
    return [entry for entry in plugin if not isinstance(entry, LevelBackend)], backends

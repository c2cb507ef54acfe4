"""The rules that are installed: our own, and those that other packages bring."""

__all__ = ["FAMILIES", "catalogue", "installed_rules"]

import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoint
from types import ModuleType

from gsgen.contract._entry_points import registered
from gsgen.contract.rules import safety, waivers
from gsgen.contract.rules.behaviour import camera, determinism, motion, robustness
from gsgen.contract.rules.graph import capture, graph, integers, naming, replay
from gsgen.contract.rules.interface import (
    declarations,
    input_declarations,
    inputs,
    manifest,
)
from gsgen.contract.rules.outputs import capacity, companions, count, graph_outputs, outputs
from gsgen.contract.rules.targets import limits, visionary, visionary_drawing
from gsgen.contract.rules.values import (
    appearance,
    cells,
    covariance,
    execution,
    extent,
    rows,
)
from gsgen.contract.spec.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend
from gsgen.contract.validation.rule import Registry, Rule, rule, rules_in, runners_in

FAMILIES = (
    manifest,
    declarations,
    inputs,
    input_declarations,
    outputs,
    count,
    companions,
    graph_outputs,
    graph,
    replay,
    capture,
    integers,
    naming,
    rows,
    execution,
    covariance,
    extent,
    appearance,
    cells,
    determinism,
    camera,
    motion,
    robustness,
    limits,
    capacity,
    safety,
    visionary,
    visionary_drawing,
    waivers,
)


def catalogue() -> list[Rule]:
    """Return our own rules, family by family, in order of their ids."""
    rules = [one for module in FAMILIES for one in rules_in(module)]
    order = list(dict.fromkeys(one.family for one in rules))
    return sorted(rules, key=lambda one: (order.index(one.family), one.id))


@cache
def installed_rules() -> Registry:
    """Return our rules and those registered under the entry point group ``gsgen.rules``.

    An entry point names a module, whose rules and runners are all taken, or a list of them. One
    that does not load becomes a crashed rule in every report.
    """
    rules = catalogue()
    runners: list[LevelBackend] = []
    points = registered("gsgen.rules")
    for number, point in enumerate(points):
        try:
            loaded, brought = _load(point)
            # Refuses an id or a level that is taken.
            Registry.of([*rules, *loaded], [*runners, *brought])
        except Exception as error:  # a third party's import may fail in any way
            loaded, brought = [_unloadable(point, number, error)], []
        rules.extend(loaded)
        runners.extend(brought)
    return Registry.of(rules, runners)


def _unloadable(point: EntryPoint, number: int, error: Exception) -> Rule:
    """Stand in for the rules of a plugin that does not load: a rule that crashes."""
    letters = re.sub("[^a-z0-9]+", "-", point.name.lower()).lstrip("-0123456789")

    @rule(
        f"{letters or 'plugin'}/XX{number:03}",
        "plugin-loads",
        Severity.ERROR,
        over="model",
        fixture="",
        kinds=KINDS,
    )
    def plugin_loads(_: object) -> Iterator[Violation]:
        """The rules of an installed plugin can be loaded.

        Why:
            Rules that do not load would be left out, and the report would look better than it is.

        Hint:
            Mend or uninstall the package that registers them.
        """
        raise ImportError(f"rules {point.name} = {point.value} do not load: {error!r}")

    return plugin_loads


def _load(point: EntryPoint) -> tuple[list[Rule], list[LevelBackend]]:
    loaded = point.load()
    if isinstance(loaded, ModuleType):
        return rules_in(loaded), runners_in(loaded)
    runners = [one for one in loaded if isinstance(one, LevelBackend)]
    return [one for one in loaded if not isinstance(one, LevelBackend)], runners

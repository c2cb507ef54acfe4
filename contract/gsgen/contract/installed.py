"""The rules that are installed: our own, and those that other packages bring."""

__all__ = ["catalogue", "installed_rules"]

from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType

from gsgen.contract.finding import Breach, Severity
from gsgen.contract.roles import KINDS
from gsgen.contract.rule import Registry, Rule, rule, rules_in
from gsgen.contract.rules import FAMILIES


def catalogue() -> list[Rule]:
    """Return our own rules, family by family, in order of their ids."""
    return [
        one for module in FAMILIES for one in sorted(rules_in(module), key=lambda r: r.id)
    ]


@cache
def installed_rules() -> Registry:
    """Return our rules and those registered under the entry point group ``gsgen.rules``.

    An entry point names a module, whose rules are all taken, or a list of rules. One that does
    not load becomes a crashed rule in every report.
    """
    rules = catalogue()
    for point in sorted(entry_points(group="gsgen.rules"), key=lambda p: p.name):
        try:
            rules.extend(_load(point))
        except Exception as error:  # a third party's import may fail in any way
            rules.append(_unloadable(point, error))
    return Registry.of(rules)


def _unloadable(point: EntryPoint, error: Exception) -> Rule:
    """Stand in for the rules of a plugin that does not load: a rule that crashes."""

    @rule(
        f"{point.name}/XX000",
        "plugin-loads",
        Severity.ERROR,
        over="model",
        fixture="",
        kinds=KINDS,
    )
    def plugin_loads(_: object) -> Iterator[Breach]:
        """The rules of an installed plugin can be loaded.

        Why:
            Rules that do not load would be left out, and the report would look better than it is.

        Mend:
            Mend or uninstall the package that registers them.
        """
        raise ImportError(f"rules {point.name} = {point.value} do not load: {error!r}")

    return plugin_loads


def _load(point: EntryPoint) -> list[Rule]:
    loaded = point.load()
    return rules_in(loaded) if isinstance(loaded, ModuleType) else list(loaded)

"""How a validation rule is declared, and the registry of installed rules.

A rule is declared once. Its page in the documentation, ``gsgen explain``, the configuration
schema and the metadata of machine-readable reports all come from that declaration.
"""

__all__ = [
    "Check",
    "Registry",
    "Rule",
    "Scope",
    "backends_in",
    "in_dependency_order",
    "rule",
    "rules_in",
]

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Literal

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.drawn_sample import DrawnSample
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRuns
from gsgen.contract.spec.fields.roles import GENERATOR
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MODEL_RUNS
from gsgen.contract.validation.level_backend import LevelBackend
from gsgen.contract.validation.waivers import Review

# What a check is given: the model before it runs, its runs, the outputs of one probe, a chunk of
# their rows, a sample of drawn rows of one probe, comparisons of all runs, the context of a level
# backend (live, render), the findings of all other rules, a tileset, or a scene file.
Scope = Literal[
    "model",
    "execution",
    "emission",
    "rows",
    "sample",
    "runs",
    "live",
    "render",
    "report",
    "tileset",
    "scene",
]
Check = Callable[[Any], Iterator[Violation]]

_ID_PATTERN = re.compile(r"^(?:[a-z][a-z0-9-]*/)?[A-Z]{2}[0-9]{3}$")
_SLUG_PATTERN = re.compile(r"^[a-z0-9]+(?:-[a-z0-9]+)*$")
# An id as people type it: GV3, gv-03, GV0003.
_TYPED_ID_PATTERN = re.compile(r"((?:[a-z][a-z0-9-]*/)?[a-z]{2})[-_ ]?([0-9]{1,9})", re.IGNORECASE)
_MAX_SUGGESTIONS = 3
_SCOPE_OF_TYPE: dict[type, Scope] = {
    InspectedModel: "model",
    ProbeRuns: "execution",
    ModelOutputs: "emission",
    Rows: "rows",
    DrawnSample: "sample",
    Behaviour: "runs",
    Review: "report",
}
_LEVEL_OF_SCOPE: dict[Scope, Level] = {
    "model": Level.STATIC,
    "execution": Level.VALUES,
    "rows": Level.VALUES,
    "emission": Level.VALUES,
    "sample": Level.VALUES,
    "runs": Level.BEHAVIOUR,
    "live": Level.LIVE,
    "render": Level.RENDER,
    "report": Level.STATIC,
    "tileset": Level.STATIC,
    "scene": Level.STATIC,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One validation rule, of the contract or of a target runtime.

    Attributes:
        id: Stable code, such as GV003; a third party's has its name in front (``acme/AC001``).
        slug: Readable name, such as ``opacity-range``.
        severity: The severity, unless a target or the user overrides it.
        level: The first level of validation that can check it.
        scope: The kind of argument that the check receives.
        statement: The sentence that must hold.
        rationale: The damage where it does not hold.
        hint: How to repair the model.
        check: Yields one violation for each location where the statement does not hold.
        needs: Rules that must hold before this one can be checked.
        kinds: The kinds of model it applies to.
        target: The only target it applies to; empty for all.
        limit: The limit of the target that it checks; the rule applies only to targets with it.
        settled_by: Rules of the level live that measure what this one predicts: where all of them
            hold, the prediction is withdrawn.
        explained_by: Rules of later levels whose fault causes this one's violations: where one of
            them fails, these are withdrawn, so that the cause is read first.
        evidence: A documented case where breaking the rule did damage; may be empty.
        at_moments: Level behaviour checks it at named moments, too, under the rule GB044.
    """

    id: str
    slug: str
    severity: Severity
    level: Level
    scope: Scope
    statement: str
    rationale: str
    hint: str
    check: Check
    needs: tuple[str, ...] = ()
    kinds: tuple[str, ...] = (GENERATOR,)
    target: str = ""
    limit: str = ""
    settled_by: tuple[str, ...] = ()
    explained_by: tuple[str, ...] = ()
    evidence: str = ""
    at_moments: bool = False

    @property
    def family(self) -> str:
        """The first two letters of the rule's id, such as GM (manifest) or GV (values)."""
        return self.id.rpartition("/")[2][:2]


def rule(
    id: str,
    severity: Severity,
    *,
    needs: tuple[str, ...] = (),
    kinds: tuple[str, ...] = (GENERATOR,),
    target: str = "",
    limit: str = "",
    settled_by: tuple[str, ...] = (),
    explained_by: tuple[str, ...] = (),
    over: Scope | None = None,
    level: Level | None = None,
    at_moments: bool = False,
) -> Callable[[Check], Rule]:
    """Declare the decorated check as a rule: its name is the rule's, its docstring the rule's page.

    The type of the check's argument says what it is given, and with that when it runs. The
    docstring's first paragraph is the statement. The sections ``Why:`` and ``Hint:`` explain
    the damage and the repair; ``Evidence:`` may follow, with a documented case.

    Args:
        id: Stable code, such as ``GV003``, or ``acme/AC001`` for a third party.
        severity: The default severity.
        needs: Rules that must hold before this one can be checked.
        kinds: The kinds of model it applies to.
        target: The only target it applies to; empty for all.
        limit: The limit of the target that it checks.
        settled_by: Rules of the level live that measure what this one predicts.
        explained_by: Rules of later levels whose fault causes this one's violations.
        over: The scope, where the argument is the context of a level backend, a tileset or a scene
            file.
        level: The first level that can check it; by default, that of the scope.
        at_moments: Check it at named moments, too: for rules that hold for every single run.

    Raises:
        ValueError: The id, the name or the docstring does not have that form, or no scope belongs
            to the argument's type.
    """

    def declare(check: Check) -> Rule:
        slug = check.__name__.replace("_", "-")
        if not _ID_PATTERN.match(id) or not _SLUG_PATTERN.match(slug):
            raise ValueError(
                f"the rule is named {id} {check.__name__}, expected an id like GV003 and a name "
                "like opacity_range"
            )
        scope = over or _scope_of_check(id, check)
        statement, rationale, hint, evidence = _doc_sections(id, inspect.getdoc(check) or "")
        return Rule(
            id=id,
            slug=slug,
            severity=severity,
            level=level or _LEVEL_OF_SCOPE[scope],
            scope=scope,
            statement=statement,
            rationale=rationale,
            hint=hint,
            check=check,
            needs=tuple(dict.fromkeys(needs)),  # groups of rules overlap
            kinds=kinds,
            target=target,
            limit=limit,
            settled_by=settled_by,
            explained_by=explained_by,
            evidence=evidence,
            at_moments=at_moments,
        )

    return declare


def _scope_of_check(id: str, check: Check) -> Scope:
    """Return the scope that the type of a check's argument says."""
    argument = next(iter(inspect.signature(check).parameters.values()))
    if argument.annotation not in _SCOPE_OF_TYPE:
        types = ", ".join(entry.__name__ for entry in _SCOPE_OF_TYPE)
        raise ValueError(f"{id}: {argument} is the argument, expected one of {types}")
    return _SCOPE_OF_TYPE[argument.annotation]


def _doc_sections(id: str, doc: str) -> tuple[str, str, str, str]:
    statement, why_section_marker, remainder = doc.partition("\nWhy:")
    rationale, hint_marker, remainder = remainder.partition("\nHint:")
    hint, _, evidence = remainder.partition("\nEvidence:")
    texts = tuple(" ".join(inspect.cleandoc(part).split()) for part in (statement, rationale, hint))
    if not (why_section_marker and hint_marker and all(texts)):
        raise ValueError(
            f"rule {id}: the docstring lacks a part, expected a statement, a `Why:` and a `Hint:` section"
        )
    return texts[0], texts[1], texts[2], " ".join(evidence.split())


def rules_in(module: ModuleType) -> list[Rule]:
    """Return the rules that a Python module declares, in order of declaration."""
    return [value for value in vars(module).values() if isinstance(value, Rule)]


def backends_in(module: ModuleType) -> list[LevelBackend]:
    """Return the backends, which run validation levels, that a Python module defines, in order."""
    return [value for value in vars(module).values() if isinstance(value, LevelBackend)]


@dataclass(frozen=True, slots=True)
class Registry:
    """All installed validation rules, and the backends that run validation levels.

    Attributes:
        rules: By id, in order of the catalogue.
        backends: The backends of the levels that other packages run.
    """

    rules: dict[str, Rule]
    backends: dict[Level, LevelBackend] = field(default_factory=dict)

    @classmethod
    def from_rules(cls, rules: Iterable[Rule], backends: Iterable[LevelBackend] = ()) -> "Registry":
        """Build a registry of rules with unique ids, and with one backend per validation level.

        Raises:
            ValueError: Two rules share an id, two backends a level, or a rule needs an unknown one.
        """
        rule_by_id: dict[str, Rule] = {}
        for entry in rules:
            if entry.id in rule_by_id:
                raise ValueError(f"rule {entry.id} is declared twice, expected unique ids")
            rule_by_id[entry.id] = entry
        for entry in rule_by_id.values():
            for needed_rule in entry.needs:
                if needed_rule not in rule_by_id:
                    raise ValueError(f"rule {entry.id} needs {needed_rule}, which does not exist")
        backend_by_level: dict[Level, LevelBackend] = {}
        for backend in backends:
            if backend.level in backend_by_level:
                raise ValueError(
                    f"validation level {backend.level.word} has two backends, expected one"
                )
            backend_by_level[backend.level] = backend
        return cls(rule_by_id, backend_by_level)

    def of_files(
        self, kind: Literal["model", "tileset", "scene"], only: Iterable[str] = ()
    ) -> "Registry":
        """Return a registry with only the rules for models, for 3D Tiles or for scene files.

        With ``only``, it has those of these ids, and the rules on which they depend.
        """
        others = {"tileset", "scene"}
        selected = self.with_needs(only) if only else self
        scope_rules = {
            id: rule
            for id, rule in selected.rules.items()
            if (rule.scope if rule.scope in others else "model") == kind
        }
        return Registry(scope_rules, self.backends)

    def with_needs(self, rule_ids: Iterable[str]) -> "Registry":
        """Return a registry with only the given rules and the rules on which they depend."""
        queue, selected_ids = [id for id in rule_ids if id in self.rules], set[str]()
        if any(self.rules[id].level > Level.STATIC for id in queue):
            queue.append(MODEL_RUNS)
        while queue:
            id = queue.pop()
            if id in self.rules and id not in selected_ids:
                selected_ids.add(id)
                queue.extend(self.rules[id].needs)
        rules = {id: rule for id, rule in self.rules.items() if id in selected_ids}
        return Registry(rules, self.backends)

    def find(self, name: str, where: str = "") -> Rule:
        """Return the validation rule with the id or slug ``name``, ignoring case.

        Raises:
            UnknownName: No rule has that name; the hint names the nearest.
        """
        for entry in self.rules.values():
            if name.lower() in (entry.id.lower(), entry.slug):
                return entry
        typed_match = _TYPED_ID_PATTERN.fullmatch(name)
        if typed_match is None:
            rule_slugs = [entry.slug for entry in self.rules.values()]
            listing = "`gsgen rules` lists them, `gsgen rules WORD` those that have a word."
            raise UnknownName.among("rule", name, rule_slugs, where, listing=listing)
        hint = _nearest_id(typed_match[1], int(typed_match[2]), list(self.rules))
        raise UnknownName(f"unknown rule {name!r}", where=where, hint=hint)


def _nearest_id(stem: str, number: int, ids: list[str]) -> str:
    """Return a hint with the known rule ids that are most similar to a mistyped id."""
    owner, slash, rule_id_letters = stem.rpartition("/")
    family = f"{owner.lower()}{slash}{rule_id_letters.upper()}"
    code = f"{family}{number:03}"
    if slash and any(rule_id.startswith(f"{owner.lower()}/XX") for rule_id in ids):
        return f"The rules of {owner.lower()!r} do not load; `gsgen validate` tells why."
    family_ids = [rule_id for rule_id in ids if rule_id[:-3] == family]
    likely_ids = [rule_id for rule_id in ids if rule_id == code or rule_id.endswith(f"/{code}")]
    likely_ids = likely_ids or [
        rule_id for rule_id in family_ids if _is_mistyped_rule_id(rule_id, code)
    ]
    if 0 < len(likely_ids) <= _MAX_SUGGESTIONS:
        return f"Did you mean {' or '.join(map(repr, likely_ids))}?"
    if family_ids:
        return (
            f"Ids of {family} are {min(family_ids)} to {max(family_ids)}; `gsgen rules` lists them."
        )
    families = ", ".join(dict.fromkeys(rule_id[:-3] for rule_id in ids))
    return f"Ids begin with {families}; `gsgen rules` lists them."


def _is_mistyped_rule_id(id: str, typed_id: str) -> bool:
    """Return whether two rule ids differ in one character, or in the order of two."""
    mismatch_count = sum(a != b for a, b in zip(id, typed_id, strict=False))
    return len(id) == len(typed_id) and (mismatch_count == 1 or sorted(id) == sorted(typed_id))


def in_dependency_order(rules: Iterable[Rule]) -> list[Rule]:
    """Sort validation rules so that each rule comes after the rules that it depends on."""
    pending_rules = {rule.id: rule for rule in rules}
    ordered_rules: list[Rule] = []

    def append(rule: Rule) -> None:
        if pending_rules.pop(rule.id, None) is None:
            return
        for needed_rule in rule.needs:
            if needed_rule in pending_rules:
                append(pending_rules[needed_rule])
        ordered_rules.append(rule)

    for rule in list(pending_rules.values()):
        append(rule)
    return ordered_rules

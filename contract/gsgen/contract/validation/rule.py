"""What a rule is, how it is declared, and the registry of all that are installed.

A rule is declared once. Its page in the documentation, ``gsgen explain``, the configuration
schema and the metadata of machine-readable reports all come from that declaration.
"""

__all__ = ["Check", "Registry", "Rule", "Scope", "rule", "rules_in", "runners_in"]

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Literal

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.roles import GENERATOR
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend

# What a check is called with: the model before it runs, the fact that it ran, the outputs of
# one probe, a chunk of their rows, or all runs compared; what the runner of a further level
# prepared; or what all other rules found.
Scope = Literal[
    "model", "execution", "emission", "rows", "runs", "live", "render", "report"
]
Check = Callable[[Any], Iterator[Violation]]

_ID = re.compile(r"^(?:[a-z][a-z0-9-]*/)?[A-Z]{2}[0-9]{3}$")
_SLUG = re.compile(r"^[a-z0-9]+(?:-[a-z0-9]+)*$")
# An id as people type it: GV3, gv-03, GV0003.
_TYPED = re.compile(r"((?:[a-z][a-z0-9-]*/)?[a-z]{2})[-_ ]?([0-9]{1,9})", re.IGNORECASE)
_MOST_SUGGESTED = 3
_LEVELS: dict[Scope, Level] = {
    "model": Level.STATIC,
    "execution": Level.VALUES,
    "rows": Level.VALUES,
    "emission": Level.VALUES,
    "runs": Level.BEHAVIOUR,
    "live": Level.LIVE,
    "render": Level.RENDER,
    "report": Level.STATIC,
}


@dataclass(frozen=True, slots=True)
class Rule:
    """One rule of the contract or of a target.

    Attributes:
        id: Stable code, such as GV003; a third party's has its name in front (``acme/AC001``).
        slug: Readable name, such as ``opacity-range``.
        severity: Unless a target or the user says otherwise.
        level: The first level of validation that can check it.
        scope: What the check looks at.
        statement: The sentence that must hold.
        why: What breaks where it does not.
        hint: How to make it hold.
        fixture: The example model that breaks this rule and no other.
        check: Yields one breach for each place where the sentence does not hold.
        needs: Rules that must hold before this one can be judged.
        kinds: The kinds of model it applies to.
        target: The only target it applies to; empty for all.
        limit: The limit of the target that it checks; without one it does not apply.
        evidence: Where it was seen to break something; empty if nobody noted it.
    """

    id: str
    slug: str
    severity: Severity
    level: Level
    scope: Scope
    statement: str
    why: str
    hint: str
    fixture: str
    check: Check
    needs: tuple[str, ...] = ()
    kinds: tuple[str, ...] = (GENERATOR,)
    target: str = ""
    limit: str = ""
    evidence: str = ""

    @property
    def family(self) -> str:
        """The letters of the id: GM, GI, GO, GG, GV, GB, GL, GS, TV or GW."""
        return self.id.rpartition("/")[2][:2]


def rule(
    id: str,
    slug: str,
    severity: Severity,
    *,
    over: Scope,
    fixture: str,
    needs: tuple[str, ...] = (),
    kinds: tuple[str, ...] = (GENERATOR,),
    target: str = "",
    limit: str = "",
    level: Level | None = None,
) -> Callable[[Check], Rule]:
    """Declare the decorated check as a rule; its docstring is the text of the rule's page.

    The docstring's first paragraph is the sentence that must hold. The sections ``Why:`` and
    ``Hint:`` say what breaks otherwise and what to do; ``Evidence:`` may follow, and say where
    that was seen.

    Raises:
        ValueError: The id, the slug or the docstring does not have that form.
    """

    def declare(check: Check) -> Rule:
        if not _ID.match(id) or not _SLUG.match(slug):
            raise ValueError(
                f"{id} {slug}: wanted an id like GV003 and a slug like opacity-range"
            )
        statement, why, hint, evidence = _sections(id, inspect.getdoc(check) or "")
        return Rule(
            id=id,
            slug=slug,
            severity=severity,
            level=level or _LEVELS[over],
            scope=over,
            statement=statement,
            why=why,
            hint=hint,
            fixture=fixture,
            check=check,
            needs=needs,
            kinds=kinds,
            target=target,
            limit=limit,
            evidence=evidence,
        )

    return declare


def _sections(id: str, doc: str) -> tuple[str, str, str, str]:
    statement, found, rest = doc.partition("\nWhy:")
    why, found_hint, rest = rest.partition("\nHint:")
    hint, _, evidence = rest.partition("\nEvidence:")
    texts = tuple(
        " ".join(inspect.cleandoc(part).split()) for part in (statement, why, hint)
    )
    if not (found and found_hint and all(texts)):
        raise ValueError(
            f"{id}: the docstring needs a sentence, a `Why:` and a `Hint:` section"
        )
    return texts[0], texts[1], texts[2], " ".join(evidence.split())


def rules_in(module: ModuleType) -> list[Rule]:
    """Return the rules that ``module`` declares, in order of declaration."""
    return [value for value in vars(module).values() if isinstance(value, Rule)]


def runners_in(module: ModuleType) -> list[LevelBackend]:
    """Return the runners that ``module`` has, in order of declaration."""
    return [value for value in vars(module).values() if isinstance(value, LevelBackend)]


@dataclass(frozen=True, slots=True)
class Registry:
    """All rules that are installed.

    Attributes:
        rules: By id, in order of the catalogue.
        runners: What prepares the levels that this package does not run itself.
    """

    rules: dict[str, Rule]
    runners: dict[Level, LevelBackend] = field(default_factory=dict)

    @classmethod
    def of(cls, rules: Iterable[Rule], runners: Iterable[LevelBackend] = ()) -> "Registry":
        """Collect rules, each id once, and runners, one a level.

        Raises:
            ValueError: Two rules share an id, two runners a level, or a rule needs one that does
                not exist.
        """
        by_id: dict[str, Rule] = {}
        for one in rules:
            if one.id in by_id:
                raise ValueError(f"rule {one.id} is declared twice")
            by_id[one.id] = one
        for one in by_id.values():
            for need in one.needs:
                if need not in by_id:
                    raise ValueError(f"rule {one.id} needs {need}, which does not exist")
        by_level: dict[Level, LevelBackend] = {}
        for runner in runners:
            if runner.level in by_level:
                raise ValueError(f"level {runner.level.word} has two runners")
            by_level[runner.level] = runner
        return cls(by_id, by_level)

    def find(self, name: str, where: str = "") -> Rule:
        """Return the rule with the id or slug ``name``, upper or lower case.

        Raises:
            UnknownName: There is none; the message names the nearest.
        """
        for one in self.rules.values():
            if name.lower() in (one.id.lower(), one.slug):
                return one
        typed = _TYPED.fullmatch(name)
        if typed is None:
            slugs = [one.slug for one in self.rules.values()]
            raise UnknownName.among("rule", name, slugs, where)
        hint = _nearest(typed[1], int(typed[2]), list(self.rules))
        raise UnknownName(f"unknown rule {name!r}", where=where, hint=hint)


def _nearest(stem: str, number: int, ids: list[str]) -> str:
    """Say which of ``ids`` may have been meant by an id that is none of them."""
    owner, slash, letters = stem.rpartition("/")
    family = f"{owner.lower()}{slash}{letters.upper()}"
    code = f"{family}{number:03}"
    kin = [one for one in ids if one[:-3] == family]
    likely = [one for one in ids if one == code or one.endswith(f"/{code}")]
    likely = likely or [one for one in kin if _mistyped(one, code)]
    if 0 < len(likely) <= _MOST_SUGGESTED:
        return f"Did you mean {' or '.join(map(repr, likely))}?"
    if kin:
        return f"Ids of {family} are {min(kin)} to {max(kin)}; `gsgen rules` lists them."
    families = ", ".join(dict.fromkeys(one[:-3] for one in ids))
    return f"Ids begin with {families}; `gsgen rules` lists them."


def _mistyped(id: str, typed: str) -> bool:
    """Say whether one digit is another, or digits stand in another order."""
    wrong = sum(a != b for a, b in zip(id, typed, strict=False))
    return len(id) == len(typed) and (wrong == 1 or sorted(id) == sorted(typed))

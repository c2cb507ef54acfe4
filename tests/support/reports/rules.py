"""Rules made up for tests."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import Rule, Scope, rule

Found = Callable[[Any], Iterable[Violation]]


def made_up(
    id: str,
    find: Found = lambda _: (),
    *,
    over: Scope = "model",
    severity: Severity = Severity.ERROR,
    needs: tuple[str, ...] = (),
    kinds: tuple[str, ...] = ("gaussian-generator",),
    target: str = "",
    limit: str = "",
    level: Level | None = None,
) -> Rule:
    """A rule that finds what ``find`` returns; nothing, if not said otherwise."""

    def check(subject: Any) -> Iterator[Violation]:
        """Something holds.

        Why:
            Because.

        Hint:
            Make it so.
        """
        yield from find(subject)

    check.__name__ = f"made_up_{id.lower().replace('/', '_')}"
    options = {"needs": needs, "kinds": kinds, "target": target, "limit": limit}
    return rule(id, severity, over=over, level=level, **options)(check)


def breaking(_: object) -> Iterator[Violation]:
    """Find one breach."""
    yield Violation.at("output g", "nine", "ten")


def crashing(_: object) -> Iterator[Violation]:
    """Fail as a rule must not."""
    raise ZeroDivisionError("no luck")
    yield

"""Rules made up for tests."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Breach
from gsgen.contract.validation.rule import Rule, Scope, rule

Found = Callable[[Any], Iterable[Breach]]


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

    def check(subject: Any) -> Iterator[Breach]:
        """Something holds.

        Why:
            Because.

        Mend:
            Make it so.
        """
        yield from find(subject)

    slug = f"made-up-{id.lower().replace('/', '-')}"
    options = {"needs": needs, "kinds": kinds, "target": target, "limit": limit}
    return rule(id, slug, severity, over=over, fixture="none", level=level, **options)(
        check
    )


def breaking(_: object) -> Iterator[Breach]:
    """Find one breach."""
    yield Breach.at("output g", "nine", "ten")


def crashing(_: object) -> Iterator[Breach]:
    """Fail as a rule must not."""
    raise ZeroDivisionError("no luck")
    yield

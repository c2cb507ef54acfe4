"""The style checks with their bars, and the comparison of measured figures with bars."""

__all__ = ["CHECKS", "Check", "Result", "run_checks"]

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from house.constants import copied_constants
from house.documentation import documentation
from house.exceptions import StyleException, excepted
from house.folders import folders
from house.import_cycles import import_cycles
from house.phrases import phrases
from house.placeholders import placeholders, placeholders_in_tests
from house.repository import Repository
from house.shaders import shaders
from house.signatures import any_types, positional_booleans, positional_fields
from house.sizes import long_files, long_functions
from house.violation import Measurement, Violation


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A style check with its bar.

    Attributes:
        name: What ``--only`` and the table of exceptions call it.
        measures: What the figure counts, in words.
        find: Returns the violations, and the size of what was searched.
        bar: The largest figure that passes; None where the figure is for information.
        per: The figure is the number of violations in so many of the total; 0: their number.
    """

    name: str
    measures: str
    find: Callable[[Repository], Measurement]
    bar: float | None = 0
    per: int = 0


CHECKS = (
    Check(
        name="placeholders",
        measures="% of the bindings have placeholder names",
        find=placeholders,
        bar=1.0,
        per=100,
    ),
    Check(
        name="placeholders-in-tests",
        measures="% of the tests' bindings have placeholder names",
        find=placeholders_in_tests,
        bar=None,
        per=100,
    ),
    Check(name="folders", measures="folders have more than 15 modules", find=folders),
    Check(name="shaders", measures="shader files are not whole, or are spliced", find=shaders),
    Check(name="cycles", measures="import cycles", find=import_cycles),
    Check(
        name="phrases", measures="banned phrases in 10,000 words", find=phrases, bar=3.0, per=10_000
    ),
    Check(name="functions", measures="functions have more than 80 lines", find=long_functions),
    Check(name="files", measures="files have more than 500 lines", find=long_files),
    Check(
        name="fields",
        measures="classes or calls pass more than four fields by position",
        find=positional_fields,
    ),
    Check(name="booleans", measures="boolean parameters are positional", find=positional_booleans),
    Check(
        name="any",
        measures="uses of Any in 1,000 lines of the runtime",
        find=any_types,
        bar=4.0,
        per=1_000,
    ),
    Check(name="constants", measures="constants are defined twice", find=copied_constants),
    Check(name="documentation", measures="imports are not public", find=documentation),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The figure of one style check, and its violations without exceptions."""

    check: Check
    figure: float
    violations: list[Violation]
    used: set[StyleException]

    @property
    def passed(self) -> bool:
        """Whether the figure is within the bar; always true without a bar."""
        return self.check.bar is None or self.figure <= self.check.bar

    def __str__(self) -> str:
        digits = 2 if self.check.per else 0
        bar = "no bar" if self.check.bar is None else f"bar {self.check.bar:g}"
        verdict = "info" if self.check.bar is None else "pass" if self.passed else "FAIL"
        count = f" ({len(self.violations)})" if self.check.per else ""
        figure = f"{self.figure:.{digits}f}"
        return f"{verdict}  {self.check.name:22}{figure:>8}{count} {self.check.measures}; {bar}"


def run_checks(
    repository: Repository, checks: Iterable[Check], exceptions: list[StyleException]
) -> list[Result]:
    """Run style checks, and remove violations that the table of exceptions permits.

    Args:
        repository: The files.
        checks: Those to run.
        exceptions: The table; entries of other checks are ignored.
    """
    results = []
    for check in checks:
        measurement = check.find(repository)
        violations, used = excepted(check.name, measurement.violations, exceptions)
        figure = float(len(violations))
        if check.per:
            figure = figure * check.per / max(measurement.total, 1)
        results.append(Result(check=check, figure=figure, violations=violations, used=used))
    return results

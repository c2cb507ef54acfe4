"""Three models, one good and two broken, judged by a part of the catalogue."""

from functools import cache
from pathlib import Path

import numpy as np

from gsgen.contract.config import Settings
from gsgen.contract.engine import validate
from gsgen.contract.finding import Severity
from gsgen.contract.installed import installed_rules
from gsgen.contract.report import Report
from gsgen.contract.rule import Registry
from support.small_models import good_rows, model, save, save_moving

# With all that they need; a new rule elsewhere does not change what is said here.
_CHOSEN = (
    *("GM001", "GM009", "GG016", "GL001", "GV001", "GV003", "GV004", "GV005", "GV006"),
    *("GV018", "GB001", "GB002", "GB003"),
)


@cache
def part_of_the_catalogue() -> Registry:
    """The chosen rules and those they need, in order of the catalogue."""
    rules = installed_rules().rules
    wanted: set[str] = set()
    queue = list(_CHOSEN)
    while queue:
        name = queue.pop()
        wanted.add(name)
        queue.extend(set(rules[name].needs) - wanted)
    return Registry.of(rule for rule in rules.values() if rule.id in wanted)


def _good(path: Path) -> Path:
    return save_moving(path, good_rows(8))


def _broken(path: Path) -> Path:
    rows = good_rows(20)
    rows[2, 0] = np.nan
    rows[3:9, 3] = [1.5, -0.25, 3, 1.25, 1.125, 2]
    rows[9, 4] = -0.01
    rows[10, 5] = 0.5
    rows[19, 3] = 0.5  # behind the count
    return save_moving(path, rows, live=18)


def _foreign(path: Path) -> Path:
    text = """
    foreign (float[4,4] noise) => (double[N,10] points, float[4,4] same)
    {
        points = Cast <to = 11> (noise)
        same = Identity (noise)
    }
    """
    return save(path, model(text))


MODELS = {"good": _good, "broken": _broken, "foreign": _foreign}


def judged(name: str, folder: Path) -> Report:
    """Make one of the models in ``folder``, the current one, and judge it."""
    path = MODELS[name](folder / f"{name}.onnx")
    settings = Settings(ignore=frozenset({"GV018"}), severities={"GV006": Severity.WARNING})
    return validate(path.name, settings, registry=part_of_the_catalogue())

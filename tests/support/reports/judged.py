"""Three models, one good and two broken, judged by a part of the catalogue."""

from dataclasses import replace
from datetime import date
from functools import cache
from pathlib import Path

import numpy as np

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.waivers import Waiver
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, model, save, save_moving

# What other rules say, or need, does not change what is said here.
_FIXTURE_RULES = (
    *("GM001", "GM002", "GM003", "GM004", "GM009", "GI001", "GI002", "GI003", "GI004"),
    *("GI005", "GO001", "GO002", "GO003", "GO005", "GO008", "GG001", "GG002", "GG010"),
    *("GG016", "GG019", "GV001", "GV003", "GV004", "GV005", "GV006", "GV018", "GV025"),
    *("GB001", "GB002", "GB003", "GL001", "GL002", "GS001", "GS002", "GS004", "GW001"),
)

# One that is needed, and one that has ended.
_WAIVERS = (
    Waiver(rule="GV005", reason="Row 9 is mended in the next export.", model="broken.onnx"),
    Waiver(rule="GM001", reason="Not ours.", model="foreign.onnx", until=date(2026, 5, 31)),
)


@cache
def part_of_the_catalogue() -> Registry:
    """The chosen rules, in order of the catalogue; what else they need is left out."""
    rules = [rule for rule in installed_rules().rules.values() if rule.id in _FIXTURE_RULES]
    return Registry.from_rules(
        replace(
            rule,
            needs=tuple(needed_rule for needed_rule in rule.needs if needed_rule in _FIXTURE_RULES),
        )
        for rule in rules
    )


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
    settings = Settings(
        ignore=frozenset({"GV018"}),
        severities={"GV006": Severity.WARNING},
        waivers=_WAIVERS,
        today=date(2026, 6, 1),
    )
    return validate(path.name, settings, registry=part_of_the_catalogue())

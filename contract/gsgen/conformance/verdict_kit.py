"""Writes the verdict kit: the example models as files, the rule that each breaks, and its probes.

It is for validators in other languages: they need neither this package nor Python. A model breaks
the rule that stands beside it and no other, and a model without a rule breaks none.
"""

__all__ = ["write_verdicts"]

import json
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from gsgen.conformance.fixtures import Fixture, fixtures
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import make_plan
from gsgen.contract.process.atomic_files import atomic_write, require_new_folder
from gsgen.contract.process.limits import Limits
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level

SCHEMA: Final = "gsgen-verdicts/1"
_MOST_BYTES: Final = 4 << 20  # of the inputs of a probe; larger ones are left out
_README: Final = """# Verdict kit

Models, and the rule of the contract of Gaussian Generators that each breaks. `index.json` has an entry for each of `models`:

| field | what it says |
|---|---|
| `model` | The file. Files beside it belong to it; some are weights of gigabytes with holes, which static rules need not read. |
| `target` | The target to validate for. |
| `rule` | The rule that does not hold; `""`: all rules hold, those of levels above `values` too. |
| `severity` | That of the rule for this target. The model is invalid if it is `error` and the finding is confirmed. |
| `level` | The level that checks the rule: `static` reads the file, `values` runs it. |
| `probes` | A JSON file: the inputs of each run at level `values`, `[{"label", "inputs": {NAME: {"dtype", "shape", "values"}}}]`, row-major. Absent: do not run the model. |

Up to level `values`, a validator finds this rule and no other; rules that need it are not applicable. Limits on time and memory are the default ones. Probes with more than 4 MiB of inputs are left out, and so are the two runs that single rules add (statement V10).
"""


def write_verdicts(folder: Path, examples: Iterable[Fixture] | None = None) -> Path:
    """Write the verdict kit into a folder, and return the path of its index.json.

    ``models`` holds the models, ``probes`` one JSON file for each model that runs: its inputs at
    the probes of level ``values``, as numbers in row-major order. The index names for each model
    the rule that it breaks, with the rule's level and its severity for the model's target; "" where
    it breaks none. ``README.md`` says so to readers who have the folder alone.

    Args:
        folder: A folder that does not exist, or is empty.
        examples: The example models, by default all. Those are left out whose rule a level above
            ``values`` checks, or that break it by a limit or a waiver of the validation.

    Raises:
        ConfigInvalid: The folder holds files or is a file.
    """
    require_new_folder(folder)
    rules = installed_rules().rules
    chosen = [
        fixture
        for fixture in (fixtures() if examples is None else examples)
        if (not fixture.rule or rules[fixture.rule].level <= Level.VALUES)
        and fixture.limits == Limits()
        and not fixture.waivers
    ]
    index_path = folder / "index.json"
    with atomic_write(index_path) as draft:
        for name in ("models", "probes"):
            (draft.parent / name).mkdir()
        entries = []
        for fixture in chosen:
            path = fixture.write(draft.parent / "models")
            entry: dict[str, Any] = {
                "model": f"models/{path.name}",
                "summary": fixture.summary,
                "target": fixture.target,
                "rule": fixture.rule,
            }
            if fixture.rule:
                rule = rules[fixture.rule]
                changed = fixture.settings.target.severities
                severity = changed.get(rule.id, rule.severity)
                entry |= {"severity": severity.word, "level": rule.level.word}
            is_run = not fixture.rule or rules[fixture.rule].level is Level.VALUES
            if is_run and fixture.level >= Level.VALUES:
                entry["probes"] = f"probes/{fixture.name}.json"
                _write_json(draft.parent / entry["probes"], _probes(path, fixture))
            entries.append(entry)
        document = {"schema": SCHEMA, "gsgen": version("gsgen"), "models": entries}
        (draft.parent / "README.md").write_text(_README, "utf-8")
        _write_json(draft, document)
    return index_path


def _write_json(path: Path, document: object) -> None:
    path.write_text(json.dumps(document, ensure_ascii=False) + "\n", "utf-8")


def _probes(path: Path, fixture: Fixture) -> list[dict[str, Any]]:
    """Return the probes of a model at level ``values``."""
    settings = fixture.settings
    subject = inspect_model(open_model(path), settings.target, settings.limits)
    plan = make_plan(subject, Level.VALUES, settings.seed)
    return [
        {"label": probe.label, "inputs": {name: _input(a) for name, a in probe.inputs.items()}}
        for probe in plan.probes[: plan.values]
        if sum(array.nbytes for array in probe.inputs.values()) <= _MOST_BYTES
    ]


def _input(array: np.ndarray) -> dict[str, Any]:
    values = array.ravel().tolist()
    return {"dtype": array.dtype.name, "shape": list(array.shape), "values": values}

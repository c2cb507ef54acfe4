"""The command line, the Python API and pytest find the same, in the same words."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from conformance.pytest_runs import property_of, run_pytest, write
from gsgen.contract import validate
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from support.commands import gsgen_here

Found = tuple[str, str, str, str]

MODELS = {"core": ("opacity_is_logits", "time_is_baked"), "visionary": ("drift", "still_sh1")}


def finding_lines(findings: Iterable[dict[str, Any]]) -> list[Found]:
    lines = []
    for finding in findings:
        where = finding["where"]["subject"], finding["where"].get("field") or ""
        lines.append((finding["rule"], *where, finding["message"]))
    return sorted(lines)


@pytest.mark.parametrize("target", MODELS)
def test_python_command_and_pytest_report_equal_findings(folder: Path, target: str) -> None:
    paths = write(folder, *MODELS[target])
    named = [path.name for path in paths]
    settings = Settings(target=load_target(target))
    python = {
        path.name: sorted(
            (finding.rule, finding.where.subject, finding.where.field, finding.message)
            for finding in validate(path, settings).findings
        )
        for path in paths
    }
    assert sum(map(len, python.values())) >= 2

    completed = gsgen_here("validate", *named, "--target", target, "--format", "json", cwd=folder)
    reports = json.loads(completed.out)["reports"]
    assert {r["subject"]["uri"]: finding_lines(r["findings"]) for r in reports} == python

    suites = gsgen_here("conformance", *named, "--target", target, "--format", "json", cwd=folder)
    models = json.loads(suites.out)["models"]
    assert {m["subject"]["uri"]: finding_lines(m["findings"]) for m in models} == python
    assert suites.code == completed.code == 1

    tested = run_pytest(folder, *[f"--gsgen={n}" for n in named], f"--gsgen-target={target}")
    by_model: dict[str, list[dict[str, Any]]] = {name: [] for name in named}
    for name, case in tested.cases.items():
        model = f"{name.partition('.onnx')[0]}.onnx"
        by_model[model] += json.loads(property_of(case, "gsgen.findings") or "[]")
    assert {name: finding_lines(actual) for name, actual in by_model.items()} == python
    failing = {r["subject"]["uri"] for r in reports if r["verdict"] != "conforms"}
    failed = {f"{name.partition('.onnx')[0]}.onnx" for name in tested.names("failure")}
    assert failed == failing

"""The validator in docs/examples/second-reader, written from the text alone, agrees with the kit."""

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from gsgen.conformance import write_verdicts
from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.field_mutations import FIELD_MUTATIONS, mutated_model
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.runtime.web.onnxruntime_web import ORT_FILES, cached_ort

READER = Path(__file__).parents[2] / "docs" / "examples" / "second-reader"
MODELS = 477
VERDICTS = 472
RULES = 459


Report = dict[str, Any]


def run_reader(*words: str | Path) -> list[Report]:
    """Run the second reader in one process, and return what it prints of each model."""
    command = ["node", *map(str, (READER / "second_reader.mjs", *words))]
    result = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    assert result.returncode == 0, result.stderr
    return [json.loads(line) for line in result.stdout.splitlines()]


def rules_of(report: Report) -> list[str]:
    """Return the rules of a report's findings."""
    return [finding["rule"] for finding in report["findings"]]


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[dict[str, Any], Report]]:
    """Each entry of the kit, and what the second reader says of its model."""
    if not all((cached_ort() / name).is_file() for name in ORT_FILES):
        message = f"missing: ONNX Runtime Web in {cached_ort()}; hint: make ort"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    index = write_verdicts(tmp_path_factory.mktemp("verdicts") / "kit")
    entries = json.loads(index.read_text("utf-8"))["models"]
    reports = run_reader("--ort", cached_ort(), index)
    assert [report["model"] for report in reports] == [entry["model"] for entry in entries]
    for entry, report in zip(entries, reports, strict=True):
        assert report["level"] == ("values" if "probes" in entry else "static")
    return list(zip(entries, reports, strict=True))


def test_verdicts_agree(pairs: list[tuple[dict[str, Any], Report]]) -> None:
    assert len(pairs) >= MODELS
    wrong = [
        entry["model"]
        for entry, report in pairs
        if report["verdict"] != ("invalid" if entry.get("severity") == "error" else "conforms")
    ]
    assert len(wrong) <= MODELS - VERDICTS, wrong


def test_rules_agree(pairs: list[tuple[dict[str, Any], Report]]) -> None:
    named = set(re.findall(r"\b[A-Z]{2}[0-9]{3}\b", (READER / "README.md").read_text("utf-8")))
    wrong = [
        (entry["model"], entry["rule"], report["findings"])
        for entry, report in pairs
        if [finding["rule"] for finding in report["findings"]]
        != list(filter(None, [entry["rule"]]))
    ]
    assert len(wrong) <= MODELS - RULES, wrong
    for model, rule, findings in wrong:
        assert not findings, (model, "a rule that holds is said to fail")
        assert rule in named, (model, "README.md does not say that the rule is not judged")


def test_readme_states_the_numbers() -> None:
    text = (READER / "README.md").read_text("utf-8")
    assert f"{MODELS} models of the kit it gives {VERDICTS}" in text
    assert f"for {RULES}." in text


def test_wrong_values_of_fields_are_noticed_as_the_file_alone_shows_them(tmp_path: Path) -> None:
    rules = installed_rules().rules
    entries = []
    for number, mutation in enumerate(FIELD_MUTATIONS):
        base = find(mutation.base)
        path = tmp_path / f"{number}.onnx"
        mutated_model(mutation, base.draw()).write(path)
        entries.append({"model": path.name, "target": base.target})
    index = tmp_path / "index.json"
    index.write_text(json.dumps({"models": entries}), "utf-8")
    for mutation, report in zip(FIELD_MUTATIONS, run_reader(index), strict=True):
        is_static = rules[mutation.rule].level is Level.STATIC
        found = rules_of(report)
        assert mutation.rule in found if is_static else not found, mutation

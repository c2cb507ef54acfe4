"""Rules that a page checks by itself: the Python functions, translated to JavaScript."""

import math
import random
from dataclasses import replace
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import Fixture, fixtures
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.limits import Limits
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.targets import load_target
from support.commands import ROOT
from support.web.pages import WebSite
from web_client.rule_module import NOT_IN_PAGES, page_rules

_RULES = page_rules()
_MOST_BYTES = 1 << 20
# Browsers read JSON: their words on its syntax are their own, and they keep the last of two keys.
_SYNTAX = "a JSON document ("
_UNDETECTED_MESSAGE = "is repeated within an object"
# A page knows the sizes of weights, not of what a runtime computes from them.
_INFERRED = ", computed from weights"


def open_outputs(subject: InspectedModel) -> set[str]:
    """Return the locations of outputs whose type or sizes the file leaves to shape inference."""
    return {
        f"output {tensor.name}"
        for tensor in subject.graph.declared_outputs
        if not tensor.dtype
        or tensor.dims is None
        or not all(isinstance(dim, int) for dim in tensor.dims)
    }


def expected_findings(path: Path, target_name: str) -> list[dict[str, str]]:
    """Return the violations of the compared rules, but of those that need one that is broken."""
    # A page knows no installed runtime, whose bounds would count.
    target = replace(load_target(target_name), follows_runtime=False)
    subject = inspect_model(open_model(path), target, Limits())
    unknown, broken = open_outputs(subject), set[str]()
    findings: list[dict[str, str]] = []
    for rule in _RULES:
        if rule.target not in ("", target.name) or (rule.limit and rule.limit not in target.limits):
            continue
        if subject.kind and subject.kind not in rule.kinds:
            continue
        is_blocked = not broken.isdisjoint(rule.needs)
        violations = [] if is_blocked else list(rule.check(subject))
        if is_blocked or violations:
            broken.add(rule.id)
        findings += [
            {
                "rule": rule.id,
                "severity": target.severities.get(rule.id, rule.severity).word,
                "where": violation.where.subject,
                "actual": violation.actual,
                "expected": violation.expected,
                "hint": rule.hint,
                "certainty": violation.certainty,
                "limit": rule.limit,
            }
            for violation in violations
            if violation.where.subject not in unknown
            and _UNDETECTED_MESSAGE not in violation.expected
            and not violation.where.subject.endswith(_INFERRED)
        ]
    return findings


def without_syntax(findings: list[dict[str, str]]) -> list[dict[str, str]]:
    """Return findings without the browser's or Python's own words and places of JSON's syntax."""
    return [
        finding | {"expected": _SYNTAX, "actual": finding["actual"].replace("^", "")[-8:]}
        if finding["expected"].startswith(_SYNTAX)
        else finding
        for finding in findings
    ]


def compared(fixture: Fixture) -> bool:
    """Return whether a page knows the example's target, and it breaks a compared rule or none."""
    names = {"", *(rule.id for rule in _RULES)}
    return fixture.suffix == ".onnx" and fixture.rule in names


def test_every_rule_of_the_page_has_the_words_of_the_contract(
    site: WebSite, tmp_path: Path
) -> None:
    models: list[tuple[str, str]] = []
    expected = []
    for fixture in filter(compared, fixtures()):
        path = fixture.write(tmp_path)
        if path.stat().st_size <= _MOST_BYTES:
            address = f"/judged/{fixture.name}.onnx"
            site.contents[address] = path.read_bytes()
            models.append((address, fixture.target))
            expected.append(expected_findings(path, fixture.target))
    actual = site.call("findings", models)
    for (address, _), findings, others in zip(models, actual, expected, strict=True):
        assert without_syntax(findings) == without_syntax(others), address
    broken = {finding["rule"] for findings in actual for finding in findings}
    assert broken == {rule.id for rule in _RULES}


def test_every_static_rule_is_checked_or_has_a_reason() -> None:
    static = {rule.id for rule in builtin_rules() if rule.scope == "model"}
    checked = [rule.id for rule in _RULES]
    assert set(checked) | set(NOT_IN_PAGES) == static
    assert not set(checked) & set(NOT_IN_PAGES)
    guide = (ROOT / "docs/guides/models-in-a-page.md").read_text("utf-8")
    assert f"{len(checked)} of the {len(static)} rules" in guide
    for number, rule in enumerate(_RULES):
        assert set(rule.needs) & set(checked) <= set(checked[:number]), rule.id


@pytest.mark.parametrize(
    ("manifest", "expected"),
    [("{", "a JSON document"), ('{"contract": "1.0", "kind": "sofa"}', "one of")],
)
def test_invalid_manifest_is_named(
    manifest: str, expected: str, site: WebSite, tmp_path: Path
) -> None:
    import onnx

    [fixture] = [fixture for fixture in fixtures() if fixture.rule == "GM006"][:1]
    model = onnx.load(fixture.write(tmp_path))
    [entry] = [entry for entry in model.metadata_props if entry.key.endswith("manifest")]
    entry.value = manifest
    site.contents["/judged.onnx"] = model.SerializeToString()
    [[finding]] = site.call("findings", [("/judged.onnx", "webgpu")])
    assert finding["rule"] == "GM002"
    assert expected in finding["expected"]


def test_numbers_and_texts_are_written_as_python_writes_them(site: WebSite) -> None:
    rng = random.Random(3)
    numbers = [
        rng.choice([-1, 1]) * rng.random() * 10.0 ** rng.randint(-20, 20) for _ in range(300)
    ]
    numbers += [0.0, 1.0, 1e16, 1e-4, 9.9999e-5, 123456.7, math.pi]
    numbers += [0.5, 1.5, 2.5, -2.5, 128.25, 128.75, 0.05, 0.15, 1.05, 100000.5, 12.34375]  # halves
    texts = ["", "it's", 'say "so"', "both ' and \"", "a\\b\n\tc", "größe", "{x}`${y}"]
    specs = ["g", ".3g", ".6g", ".1f", ".0f"]
    expected = [[repr(number), *(format(number, spec) for spec in specs)] for number in numbers]
    actual = site.call("written", numbers, texts, specs)
    assert actual == [expected, [repr(text) for text in texts]]

"""Rules that a page checks by itself, beside the contract's own."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import Fixture, fixtures
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.limits import Limits
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec.targets import load_target
from gsgen.runtime.web.plans import PAGE_RULES
from support.web.pages import WebSite

_RULES = {entry.id: entry for entry in builtin_rules() if entry.id in PAGE_RULES}
_MOST_BYTES = 1 << 20
# What a page checks of a manifest's schema is less, and its words on JSON are the browser's.
_COMPARED = [name for name in PAGE_RULES if name != "GM002"]


def expected_findings(path: Path) -> list[dict[str, str]]:
    """Return the violations of the compared rules, but of those that need one that is broken."""
    subject = inspect_model(open_model(path), load_target("webgpu"), Limits())
    violations = {name: list(_RULES[name].check(subject)) for name in _COMPARED}
    return [
        {
            "rule": name,
            "severity": _RULES[name].severity.word,
            "where": violation.where.subject,
            # A page does not say where else in the model a manifest is.
            "actual": violation.actual.partition(", but ")[0],
            "expected": violation.expected,
            "hint": _RULES[name].hint,
        }
        for name in _COMPARED
        if not any(violations.get(needed) for needed in _RULES[name].needs)
        for violation in violations[name]
    ]


def compared(fixture: Fixture) -> bool:
    """Return whether a page can have Python's words: in JavaScript, 1.0 is written 1."""
    if fixture.name == "manifest_version_is_a_number":
        return False
    return fixture.suffix == ".onnx" and fixture.rule in ("", *_COMPARED)


def test_every_rule_of_the_page_has_the_words_of_the_contract(
    site: WebSite, tmp_path: Path
) -> None:
    broken = set()
    for fixture in filter(compared, fixtures()):
        path = fixture.write(tmp_path)
        if path.stat().st_size > _MOST_BYTES:
            continue
        site.contents["/judged.onnx"] = path.read_bytes()
        actual = sorted(site.call("findings", "/judged.onnx"), key=lambda each: each["rule"])
        expected = sorted(expected_findings(path), key=lambda each: each["rule"])
        assert actual == expected, fixture.name
        broken |= {finding["rule"] for finding in actual}
    assert broken == set(_COMPARED)


@pytest.mark.parametrize(
    ("manifest", "expected"),
    [("{", "a JSON document"), ('{"contract": "1.2", "kind": "sofa"}', "one of")],
)
def test_a_manifest_that_is_none_is_named(
    manifest: str, expected: str, site: WebSite, tmp_path: Path
) -> None:
    import onnx

    [fixture] = [fixture for fixture in fixtures() if fixture.rule == "GM006"][:1]
    model = onnx.load(fixture.write(tmp_path))
    [entry] = [entry for entry in model.metadata_props if entry.key.endswith("manifest")]
    entry.value = manifest
    site.contents["/judged.onnx"] = model.SerializeToString()
    [finding] = site.call("findings", "/judged.onnx")
    assert finding["rule"] == "GM002"
    assert expected in finding["expected"]

"""Whatever a model, a tensor or a folder is called, every report stays what it is."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft4Validator, Draft202012Validator

from gsgen.contract.reporters.document import schema
from gsgen.contract.reporters.github import to_github
from gsgen.contract.reporters.json_report import to_json
from gsgen.contract.reporters.junit import to_junit
from gsgen.contract.reporters.markdown import code, to_markdown
from gsgen.contract.reporters.sarif import to_sarif
from gsgen.contract.reporters.text import render_all
from gsgen.contract.validation.finding import Location
from support.reports.sarif import SCHEMA

pytestmark = pytest.mark.slow


JSON_SCHEMA = Draft202012Validator(schema())
SARIF_SCHEMA = Draft4Validator(SCHEMA)
PIECES = st.sampled_from(
    [
        *("\n", "\r", "\x00", "\x1b[2J", "\u2028", "\ufffe", "\U0001f4a5"),
        *("%", "%0A", "::", "::error::", "##[error]", ",", "="),
        *('"', "'", "<", ">", "&", "]]>", "`", "```", "|", "\\"),
    ]
)
# Linux gives a byte of a path that is no UTF-8 as half a surrogate pair.
BYTES = st.characters(min_codepoint=0xDC80, max_codepoint=0xDCFF, categories=("Cs",))
NAMES = st.lists(PIECES | st.text(max_size=4), max_size=6).map("".join)
PATHS = st.lists(PIECES | BYTES | st.text(max_size=4), min_size=1, max_size=6).map("".join)


@settings(max_examples=60)
@given(name=NAMES, path=PATHS)
def test_every_format_survives(reports, name, path):
    report = report_named(reports["broken"], name, path)
    encoded = [
        form([report]).encode() for form in (to_json, to_sarif, to_junit, to_markdown, to_github)
    ]
    document, log, suites = json.loads(encoded[0]), json.loads(encoded[1]), encoded[2]
    JSON_SCHEMA.validate(document)
    SARIF_SCHEMA.validate(log)
    assert document["subject"]["uri"] == path
    assert document["findings"][0]["where"]["subject"] == name
    assert document["findings"][0]["fingerprint"] == report.findings[0].fingerprint
    assert len(log["runs"][0]["results"]) == len(report.findings)
    cases = list(ElementTree.fromstring(suites).iter("testcase"))
    assert len(cases) == len(report.outcomes)
    counted = sum(finding.counts for finding in report.findings)
    lines = to_github([report]).split("\n")
    assert sum(line.startswith("::") for line in lines) == counted
    assert len(lines) == counted + 1
    assert code(name) in to_markdown([report])
    assert all(line.text.isprintable() for line in render_all([report, report]))


def report_named(report, name, path):
    findings = tuple(
        replace(finding, where=Location(name), message=name, waiver=name and finding.waiver)
        for finding in report.findings
    )
    return replace(report, path=path, name=name, findings=findings)

import subprocess
import sys

from gsgen.contract.spec.manifest import CONTRACT_VERSION
from gsgen.contract.spec.severity import Level
from gsgen.tiles.validation.rules import all_rules
from support.commands import ROOT
from support.reports.pages import pages

SCRIPT = ROOT / "scripts" / "write_docs.py"


def test_generated_pages_are_current():
    command = [sys.executable, SCRIPT, "--check"]
    completed = subprocess.run(command, capture_output=True, text=True)
    command_hint = "run: .venv/bin/python scripts/write_docs.py"
    assert completed.returncode == 0, (
        f"{command_hint}\nnot current:\n{completed.stdout}{completed.stderr}"
    )


def test_every_marker_is_closed():
    for page in pages():
        text = page.read_text("utf-8")
        assert text.count("<!-- generated: ") == text.count("<!-- end generated -->"), page


def test_handwritten_counts_are_correct():
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    rules = [rule for rule in all_rules().rules.values() if "/" not in rule.id]
    assert "of twelve families at the levels static, values, behaviour, live and render" in changes
    assert len({rule.family for rule in rules}) == 12
    assert [level.word for level in Level] == ["static", "values", "behaviour", "live", "render"]
    specification = (ROOT / "docs" / "spec" / "index.md").read_text("utf-8")
    assert specification.startswith(f"# The contract, version {CONTRACT_VERSION}\n")
    assert f"The contract, version {CONTRACT_VERSION}:" in changes

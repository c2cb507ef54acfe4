import subprocess
import sys

from gsgen.conformance.fixtures import find
from gsgen.contract import validate
from support.commands import ROOT
from support.pages import DOCS, pages

SCRIPT = ROOT / "scripts" / "write_docs.py"


def test_generated_pages_are_current():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--check"], capture_output=True, text=True
    )
    advice = "run: .venv/bin/python scripts/write_docs.py"
    assert done.returncode == 0, f"{advice}\nnot current:\n{done.stdout}{done.stderr}"


def test_every_marker_is_closed():
    for page in pages():
        text = page.read_text("utf-8")
        assert text.count("<!-- generated: ") == text.count("<!-- end generated -->"), page


def test_the_table_of_report_fields_is_complete(tmp_path):
    """Every field of a real report is in the table, and no other."""
    seen: set[str] = set()
    for name in ("opacity_is_logits", "nan_late", "extra_input", "manifest_wrong_field"):
        report = validate(find(name).write(tmp_path))
        seen |= set(_paths(_as_json(report)))
    page = (DOCS / "spec" / "levels.md").read_text("utf-8")
    table = page.partition("<!-- test: report fields -->")[2].partition("\n\n")[0]
    listed = {line.split("`")[1] for line in table.splitlines() if line.startswith("| `")}
    assert listed == seen


def _as_json(report: object) -> object:
    from gsgen.contract.reporters.machine import to_dict

    return to_dict(report)  # type: ignore[arg-type]


def _paths(value: object, path: str = "") -> set[str]:
    """Return the dotted paths of all leaves; objects that the table takes as a whole are leaves."""
    if isinstance(value, dict) and path not in ("environment", "findings[].stats.worst"):
        inner = [_paths(v, f"{path}.{k}".lstrip(".")) for k, v in value.items()]
        return set().union(*inner)
    if isinstance(value, list):
        return set().union(*(_paths(one, f"{path}[]") for one in value))
    return {path}

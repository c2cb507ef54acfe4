import subprocess
import sys

from support.commands import ROOT
from support.pages import pages

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

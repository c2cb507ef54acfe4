"""Show above each code block of the built site the file that the comment in front of it names.

Run the script after the site was built: .venv/bin/python scripts/name_files.py site
"""

import re
import sys
from pathlib import Path

_BLOCK = re.compile(
    r"(<!-- (?:test|family|example|lgm): ([\w./-]+\.\w+) -->"
    r'\s*<div class="[\w -]*highlight">)(?=<pre>)'
)


def named_blocks(html: str) -> str:
    """Return a page with file names as the theme shows them; one that has them stays."""
    return _BLOCK.sub(r'\1<span class="filename">\2</span>', html)


if __name__ == "__main__":
    for page in Path(sys.argv[1]).rglob("*.html"):
        page.write_text(named_blocks(page.read_text("utf-8")), "utf-8")

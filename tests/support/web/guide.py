"""The lines of pages in the guide of the element."""

import re

from support.commands import ROOT

_GUIDE = (ROOT / "docs/guides/models-in-a-page.md").read_text("utf-8")

LINES = dict(re.findall(r"<!-- page: (\S+) -->\n```html\n(.*?)```", _GUIDE, re.DOTALL))
"""What pages copy, by the page's name."""

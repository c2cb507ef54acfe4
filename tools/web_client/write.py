"""Write what the browser client takes from Python: frame plans, rules and markup (`make web`)."""

import json
from pathlib import Path
from typing import Final

from web_client.plans import plans_text
from web_client.rule_module import rules_text

CLIENT: Final = Path(__file__).parents[2] / "runtime/gsgen/runtime/web/client"
"""The folder of the browser client."""


def markup_text() -> str:
    """Return the text of ``element_markup.js``, the ES module with the HTML and CSS of the element."""
    markup = Path(__file__).with_name("element.html").read_text("utf-8")
    return f"// Written by `make web` from element.html.\nexport const MARKUP = {json.dumps(markup)};\n"


WRITTEN: Final = {
    "plans.json": plans_text,
    "contract_rules.js": rules_text,
    "element_markup.js": markup_text,
}
"""The written files of the client, each with the function that returns its text."""


if __name__ == "__main__":
    for name, text in WRITTEN.items():
        (CLIENT / name).write_text(text(), "utf-8")

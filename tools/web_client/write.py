"""Write what the browser client takes from Python: plans, rules, kinds of files (`make web`)."""

from pathlib import Path
from typing import Final

from web_client.plans import plans_text
from web_client.rule_module import kinds_text, rules_text

CLIENT: Final = Path(__file__).parents[2] / "runtime/gsgen/runtime/web/client"
"""The folder of the browser client."""


WRITTEN: Final = {
    "plans.json": plans_text,
    "contract_rules.js": rules_text,
    "file_kinds.js": kinds_text,
}
"""The written files of the client, each with the function that returns its text."""


if __name__ == "__main__":
    for name, text in WRITTEN.items():
        (CLIENT / name).write_text(text(), "utf-8")

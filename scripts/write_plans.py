"""Write what the browser client takes from Python: plans.json, contract_rules.js."""

from pathlib import Path

from gsgen.runtime.web.plans import PLANS_FILE, plans_text
from gsgen.runtime.web.rule_module import RULES_FILE, rules_text

_ROOT = Path(__file__).parents[1]


def main() -> None:
    """Write the recorded frame plans and the translated rules into the client's package."""
    for file, text in ((PLANS_FILE, plans_text()), (RULES_FILE, rules_text())):
        package, _, path = file.partition(":")
        folder = _ROOT / "runtime" / package.replace(".", "/")
        (folder / path).write_text(text, "utf-8")


if __name__ == "__main__":
    main()

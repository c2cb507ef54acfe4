"""Write what the browser client takes from Python: plans, rules and markup."""

from pathlib import Path

from gsgen.runtime.web.pages import MARKUP_FILE, markup_text
from gsgen.runtime.web.plans import PLANS_FILE, plans_text
from gsgen.runtime.web.rule_module import RULES_FILE, rules_text

_ROOT = Path(__file__).parents[1]


def main() -> None:
    """Write the recorded frame plans, the translated rules and the markup into the client's package."""
    written = ((PLANS_FILE, plans_text()), (RULES_FILE, rules_text()), (MARKUP_FILE, markup_text()))
    for file, text in written:
        package, _, path = file.partition(":")
        folder = _ROOT / "runtime" / package.replace(".", "/")
        (folder / path).write_text(text, "utf-8")


if __name__ == "__main__":
    main()

"""The corpus of example models as tables."""

from docs_parts.rules import ours
from docs_parts.tables import table
from gsgen.conformance.fixtures import fixtures


def good() -> str:
    """Return the models that keep the contract."""
    rows = [(f"`{f.name}`", f"`{f.target}`", f.summary) for f in fixtures() if not f.rule]
    return table(("model", "good for", "its property"), rows)


def broken() -> str:
    """Return the models that break one rule each."""
    rows = []
    for fixture in fixtures():
        if fixture.rule:
            name = f"{fixture.rule} {ours().rules[fixture.rule].slug}"
            link = f"[{name}](../rules/{fixture.rule}.md)"
            rows.append((f"`{fixture.name}`", link, f"`{fixture.target}`", fixture.summary))
    return table(("model", "breaks", "checked for", "its property"), rows)

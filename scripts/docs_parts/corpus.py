"""The corpus of example models as tables."""

from docs_parts.rules import ours
from docs_parts.tables import table
from gsgen.conformance.fixtures import fixtures


def good() -> str:
    """Return the models that keep the contract."""
    rows = [(f"`{f.name}`", f"`{f.target}`", f.summary) for f in fixtures() if not f.rule]
    return table(("model", "good for", "what is special"), rows)


def broken() -> str:
    """Return the models that break one rule each."""
    rows = []
    for one in fixtures():
        if one.rule:
            name = f"{one.rule} {ours().rules[one.rule].slug}"
            link = f"[{name}](../rules/{one.rule}.md)"
            rows.append((f"`{one.name}`", link, f"`{one.target}`", one.summary))
    return table(("model", "breaks", "judged for", "what is special"), rows)

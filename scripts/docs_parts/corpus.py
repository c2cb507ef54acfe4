"""The example models that keep the contract, as a table."""

from docs_parts.tables import table
from gsgen.conformance.fixtures import fixtures


def good() -> str:
    """Return the models that keep the contract."""
    rows = [(f"`{f.name}`", f"`{f.target}`", f.summary) for f in fixtures() if not f.rule]
    return table(("model", "good for", "its property"), rows)

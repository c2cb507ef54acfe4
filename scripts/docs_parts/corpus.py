"""The example models that keep the contract, as a table."""

import re

from docs_parts.tables import table
from gsgen.conformance.fixtures import fixtures

_USUAL_KIND = re.compile("^(An )?ONNX generator ")


def good() -> str:
    """Return the models that keep the contract."""
    rows = [
        (f"`{f.name}`", f"`{f.target}`", _USUAL_KIND.sub("", f.summary))
        for f in fixtures()
        if not f.rule
    ]
    return table(("model", "good for", "an ONNX generator, where nothing else is said"), rows)

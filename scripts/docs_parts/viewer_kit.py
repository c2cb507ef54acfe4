"""Tables of the viewer kit: its cases, and the faults that they show."""

from docs_parts.tables import table
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.write import kit_cases

_OF_ROLE = "role-"


def cases() -> str:
    """Return the table of the cases."""
    return table(
        ["case", "what it tests"], [[f"`{case.name}`", case.tests] for case in kit_cases()]
    )


def faults() -> str:
    """Return the table of the faults; those of roles differ by their name alone."""
    rows = [
        [f"`{fault}`", f"{title}. {hint}"]
        for fault, (title, hint) in VIEWER_FAULTS.items()
        if not fault.startswith(_OF_ROLE)
    ]
    text = (
        "an input of that role keeps its default. Find inputs by their role, not by their name, "
        "and feed them in every frame."
    )
    return table(
        ["fault", "what the viewer does, and the repair"], [*rows, [f"`{_OF_ROLE}ROLE`", text]]
    )

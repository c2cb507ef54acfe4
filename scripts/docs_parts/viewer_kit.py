"""Tables of the viewer kit: its cases, and the faults that they show."""

from docs_parts.tables import table
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.write import kit_cases

_OF_ROLE = "role-"


def cases() -> str:
    """Return the table of the cases."""
    rows = [[f"`{case.name}`", case.tests, str(len(case.frames))] for case in kit_cases()]
    return table(["case", "what it tests", "frames"], rows)


def faults() -> str:
    """Return the table of the faults, each with its cases; those of roles differ by their name."""
    rows, of_roles = [], []
    for fault, (title, hint) in VIEWER_FAULTS.items():
        listed = _list_cases(fault)
        if fault.startswith(_OF_ROLE):
            of_roles.append(f"`{fault.removeprefix(_OF_ROLE)}`: {listed}")
        else:
            rows.append([f"`{fault}`", f"{title}. {hint}", listed])
    text = (
        "an input of that role keeps its default. Find inputs by their role, not by their name, "
        "and feed them in every frame."
    )
    rows.append([f"`{_OF_ROLE}ROLE`", text, "; ".join(of_roles)])
    return table(["fault", "what the viewer does, and the repair", "cases"], rows)


def _list_cases(fault: str) -> str:
    cases = kit_cases()
    spoiled = [f"`{case.name}`" for case in cases if fault in case.faults]
    right = [f"`{case.name}`" for case in cases if fault not in case.faults]
    if len(spoiled) <= len(right):
        return ", ".join(spoiled)
    return f"all but {', '.join(right)}" if right else "all"

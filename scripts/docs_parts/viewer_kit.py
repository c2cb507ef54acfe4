"""Tables of the viewer kit: its cases, and the faults that they show."""

from docs_parts.tables import table
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.write import kit_cases


def cases() -> str:
    """Return the table of the cases."""
    rows = [[f"`{case.name}`", case.tests, str(len(case.frames))] for case in kit_cases()]
    return table(["case", "what it tests", "frames"], rows)


def faults() -> str:
    """Return the table of the faults, each with its cases."""
    rows = []
    for fault, (title, hint) in VIEWER_FAULTS.items():
        names = [case.name for case in kit_cases() if fault in case.faults]
        listed = "all" if len(names) == len(kit_cases()) else ", ".join(f"`{n}`" for n in names)
        rows.append([f"`{fault}`", f"{title}. {hint}", listed])
    return table(["fault", "what the viewer does, and the repair", "cases"], rows)

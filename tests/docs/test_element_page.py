"""The page of the element names its attributes, properties, methods and events, and no others."""

import re

from gsgen.runtime.web.pages import client_file
from support.commands import ROOT

_PAGE = (ROOT / "docs/element.md").read_text("utf-8")
_ELEMENT = "".join(client_file(name).decode() for name in ("element.js", "model_controls.js"))


def first_cells(heading: str) -> set[str]:
    """Return the code words in the first column of the table with a heading."""
    table = _PAGE.split(f"| {heading} |", 1)[1].split("\n\n", 1)[0]
    cells = [line.split("|")[1] for line in table.splitlines()[2:]]
    return {word for cell in cells for word in re.findall(r"`([^`(]+)[^`]*`", cell)}


def attributes() -> set[str]:
    table = client_file("attributes.js").decode().split("export const ATTRIBUTES = {", 1)[1]
    return set(re.findall(r'^  "?([a-z-]+)"?: ', table.split("\n};", 1)[0], re.M))


def test_the_page_has_a_row_of_every_attribute() -> None:
    assert len(attributes()) > 20
    assert first_cells("attribute") == attributes()


def test_every_attribute_has_a_typed_property() -> None:
    text = client_file("attributed_element.js").decode()
    typedef = text.split("@typedef {object} ReflectedAttributes", 1)[1].split("*/", 1)[0]
    typed = set(re.findall(r"@property \{[^}]+\} (\w+)", typedef))
    names = {re.sub("-(.)", lambda match: match[1].upper(), name) for name in attributes()}
    assert typed == names


def test_the_page_has_the_public_members_of_the_element() -> None:
    getters = set(re.findall(r"^  get ([a-z]\w*)\(", _ELEMENT, re.M)) | {"report", "warnings"}
    assert first_cells("property") == getters
    methods = set(re.findall(r"^  (?:async )?([a-z]\w*)\([^)]*\) \{$", _ELEMENT, re.M))
    assert first_cells("method") == methods - {"constructor"} - {
        name for name in methods if name.endswith("Callback")
    }


def test_the_page_has_every_event() -> None:
    events = set(re.findall(r'_tell\("([a-z-]+)"', _ELEMENT)) | {"warning", "load", "recover"}
    events |= {"play", "pause"}
    line = next(line for line in _PAGE.splitlines() if line.startswith("Events: "))
    assert set(re.findall(r"`([a-z-]+)`", line)) == events

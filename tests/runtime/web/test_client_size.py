"""The browser client stays small."""

import gzip
import re
from importlib.resources import files

_CLIENT = files("gsgen.runtime.web").joinpath("client")
_GENERATED_FILES = {"contract_rules.js", "file_kinds.js", "fzstd.js"}  # by `make web`, or a library
_TEXTS = {
    file.name: file.read_text("utf-8") for file in _CLIENT.iterdir() if file.name.endswith(".js")
}


def imported_by(name: str, known: frozenset[str] = frozenset()) -> frozenset[str]:
    """Return the modules that the browser loads with a module, without those loaded on demand."""
    known |= {name}
    for neighbour in re.findall(r'^(?:import|export) [^;]*?"\./([^"]+)";', _TEXTS[name], re.M):
        if neighbour not in known:
            known = imported_by(neighbour, known)
    return known


def test_the_client_has_few_lines() -> None:
    written = {name: text for name, text in _TEXTS.items() if name not in _GENERATED_FILES}
    assert 1000 < sum(text.count("\n") for text in written.values()) <= 10_056


def test_adapters_of_other_engines_have_few_lines() -> None:
    texts = [
        file.read_text("utf-8")
        for file in _CLIENT.joinpath("engines").iterdir()
        if file.name.endswith(".js")
    ]
    assert 100 < sum(text.count("\n") for text in texts) <= 1000


def test_the_element_is_loaded_fast() -> None:
    core = imported_by("gsgen.js")
    assert {"element.js", "matrices.js", "errors.js"} <= core
    assert not core & {"generator.js", "contract_rules.js", "tileset.js", "sog.js"}
    assert len(gzip.compress("".join(_TEXTS[name] for name in sorted(core)).encode())) <= 70_000

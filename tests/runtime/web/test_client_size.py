"""The browser client stays small."""

import gzip
from importlib.resources import files

_CLIENT = files("gsgen.runtime.web").joinpath("client")
_GENERATED_FILES = {"contract_rules.js", "element_markup.js"}  # by `make web`
_TEXTS = [
    file.read_text("utf-8")
    for file in _CLIENT.iterdir()
    if file.name.endswith(".js") and file.name not in _GENERATED_FILES
]
_MARKUP = _CLIENT.joinpath("element_markup.js").read_text("utf-8")


def test_the_client_has_few_lines() -> None:
    assert 1000 < sum(text.count("\n") for text in _TEXTS) <= 3500


def test_the_client_is_loaded_fast() -> None:
    assert len(gzip.compress("".join([*_TEXTS, _MARKUP]).encode())) <= 60_000

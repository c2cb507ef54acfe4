"""The browser client stays small."""

import gzip
from importlib.resources import files

_CLIENT = files("gsgen.runtime.web").joinpath("client")
_WRITTEN = "contract_rules.js"  # by `make web`, and loaded with the first generator
_TEXTS = [
    file.read_text("utf-8")
    for file in _CLIENT.iterdir()
    if file.name.endswith(".js") and file.name != _WRITTEN
]


def test_the_client_has_few_lines() -> None:
    assert 1000 < sum(text.count("\n") for text in _TEXTS) <= 3500


def test_the_client_is_loaded_fast() -> None:
    assert len(gzip.compress("".join(_TEXTS).encode())) <= 60_000

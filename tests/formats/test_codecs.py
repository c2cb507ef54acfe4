"""The table of codecs is the one home of what states the splat formats."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract.file_kinds.names import META_FILE, SPLAT_FORMATS, SPLAT_SUFFIXES, STREAMED_META
from gsgen.formats import CODECS

ROOT = Path(__file__).parents[2]
PRODUCT = ("contract", "sdk", "runtime", "reference_plugins")
SUFFIXES = {suffix for codec in CODECS for suffix in codec.suffixes}
TITLES = re.compile(
    rf"\b({'|'.join(sorted((codec.title for codec in CODECS), key=len, reverse=True))})\b"
)
# The contract, which knows no format, lists the suffixes of splats and of meshes in one module.
CONTRACT_LIST = "contract/gsgen/contract/file_kinds/names.py"


def lists_of_formats(source: str) -> Iterator[int]:
    """Yield the lines with two suffixes in one literal, or three titles in one text."""
    if sum(suffix in source for suffix in SUFFIXES) < 2 and len(set(TITLES.findall(source))) < 3:
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Tuple | ast.List | ast.Set | ast.Dict):
            parts = node.keys if isinstance(node, ast.Dict) else node.elts
            values = {part.value for part in parts if isinstance(part, ast.Constant)}
            is_list = len(values & SUFFIXES) >= 2
        else:
            text = node.value if isinstance(node, ast.Constant) else None
            is_list = isinstance(text, str) and len(set(TITLES.findall(text))) >= 3
        if is_list:
            yield node.lineno


def test_no_other_module_lists_the_splat_formats():
    copies = [
        f"{path.relative_to(ROOT)}:{line}"
        for part in PRODUCT
        for path in sorted((ROOT / part).rglob("*.py"))
        if "formats" not in path.relative_to(ROOT).parts and path != ROOT / CONTRACT_LIST
        for line in lists_of_formats(path.read_text("utf-8"))
    ]
    assert copies == [], "take them from gsgen.formats.codecs.CODECS"


def test_the_suffixes_of_the_contract_are_those_of_splats_alone():
    holds_other_things = {".glb", ".pt", ".pth", ".ckpt", ".npz", META_FILE, STREAMED_META}
    assert {f".{suffix.rpartition('.')[2]}" for suffix in SUFFIXES - holds_other_things} == set(
        SPLAT_SUFFIXES
    )


@pytest.mark.parametrize(
    "source",
    [
        'SCENES = (".ply", ".npz", ".splat")',
        'READERS = {".ply": 1, ".spz": 2}',
        'HELP = "A PLY, SPZ or KSPLAT file."',
    ],
)
def test_a_copy_of_the_list_is_seen(source):
    assert list(lists_of_formats(source)) == [1]


def test_single_suffixes_and_titles_are_no_list():
    assert not list(lists_of_formats('WEIGHTS = (".ply", ".safetensors"); TEXT = "PLY or GLB"'))


def test_every_name_and_suffix_belongs_to_one_format():
    suffixes = [suffix for codec in CODECS for suffix in codec.suffixes]
    assert len(set(suffixes)) == len(suffixes)
    assert len({codec.name for codec in CODECS}) == len(CODECS)


def test_only_formats_that_are_written_state_their_loss():
    assert all(bool(codec.loss) == bool(codec.write) for codec in CODECS)


def test_the_titles_are_enumerated():
    *titles, last = (codec.title for codec in CODECS)
    assert f"{', '.join(titles)} or {last}" == SPLAT_FORMATS

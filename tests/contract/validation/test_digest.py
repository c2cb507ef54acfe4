import hashlib
from dataclasses import replace

import pytest

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation import digest as digests
from gsgen.contract.validation.digest import digest, rules_digest
from support.reports.rules import made_up

RULES = [made_up("GV901"), made_up("GV902", needs=("GV901",))]


@pytest.mark.parametrize("size", [0, 1, (1 << 20) - 1, 1 << 20, (1 << 20) + 1])
def test_a_file_is_digested_chunk_by_chunk(tmp_path, size):
    path = tmp_path / "a.onnx"
    path.write_bytes(b"x" * size)
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert digest(path, Level.STATIC, size) == expected


@pytest.mark.parametrize(
    ("level", "size", "read"),
    [(Level.STATIC, 9, True), (Level.STATIC, 10, False), (Level.VALUES, 10, True)],
)
def test_large_files_are_left_alone_where_nothing_runs(tmp_path, monkeypatch, level, size, read):
    monkeypatch.setattr(digests, "_STATIC_BYTES", 10)
    path = tmp_path / "a.onnx"
    path.write_bytes(b"x" * size)
    assert bool(digest(path, level, size)) is read


@pytest.mark.parametrize(
    "change",
    [
        {"severity": Severity.INFO},
        {"statement": "Another."},
        {"needs": ()},
        {"limit": "rows"},
        {"evidence": "Seen."},
        {"id": "GV903"},
    ],
)
def test_rules_that_declare_something_else_have_another_digest(change):
    first, second = RULES
    same = rules_digest(RULES)
    assert same == rules_digest([first, replace(second)])
    assert same != rules_digest([first, replace(second, **change)])
    assert same.startswith("sha256:")

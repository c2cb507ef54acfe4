"""Addresses of inputs are told from paths."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsgen.contract.inputs.addresses import address_of, file_name, folder_of, is_plain_location


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("https://a/b.ply", "https://a/b.ply"),
        ("HTTP://a/b.ply?x=//y", "http://a/b.ply?x=//y"),
        ("https:/a/b.ply", "https://a/b.ply"),
        ("hf://owner/name/a.ply", "hf://owner/name/a.ply"),
        ("s3://bucket/a.ply", "s3://bucket/a.ply"),
        ("file:///tmp/a.ply", "file:///tmp/a.ply"),
        ("a.ply", ""),
        ("/tmp/a.ply", ""),
        ("C:/scenes/a.ply", ""),
        ("C:\\scenes\\a.ply", ""),
        ("-", ""),
        ("", ""),
        ("orbit:10,20", ""),
        ("look-at:1,2,3,0,0,0", ""),
        ("a:b/c.ply", ""),
    ],
)
def test_an_address_has_a_scheme_and_a_slash(text: str, address: str) -> None:
    assert address_of(text) == address


def test_a_folder_named_like_a_scheme_is_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "s3:").mkdir()
    (tmp_path / "s3:/a.ply").write_bytes(b"x")
    monkeypatch.chdir(tmp_path)
    assert address_of(Path("s3:/a.ply")) == ""


@given(path=st.text(max_size=40))
def test_the_name_of_a_copy_is_one_short_plain_word(path: str) -> None:
    name = file_name(f"https://host/{path}".replace("[", "").replace("]", ""))
    assert name
    assert len(name) <= 120
    assert name.isascii()
    assert not name.startswith(".")
    assert not set(name) & set('/\\:*?"<>| \n')


@pytest.mark.parametrize(
    ("location", "is_plain"),
    [
        ("weights.bin", True),
        ("data/weights.bin", True),
        ("../weights.bin", False),
        ("a/../../weights.bin", False),
        ("..\\weights.bin", False),
        ("/etc/passwd", False),
        ("C:\\x", False),
        ("\\\\host\\share", False),
        ("", False),
        ("a\nb", False),
    ],
)
def test_a_location_beside_a_file_stays_below_its_folder(location: str, is_plain: bool) -> None:
    assert is_plain_location(location) is is_plain


def test_the_folder_of_an_address_has_no_query() -> None:
    assert folder_of("https://a/b/c.onnx?sig=1/2") == "https://a/b/"
    assert folder_of("s3://bucket/c.onnx") == "s3://bucket/"

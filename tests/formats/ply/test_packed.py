"""Elements of compressed PLY files: how many boxes they need."""

import numpy as np
import pytest

from gsgen.formats import HeaderMalformed, read_ply, write_compressed_ply
from support.splat_files import FIELDS, scene


def test_boxes_beyond_those_of_the_splats_are_ignored(tmp_path):
    write_compressed_ply(tmp_path / "a.ply", scene(300, 1))
    head, end, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    assert b"element chunk 2\n" in head
    more = head.replace(b"element chunk 2\n", b"element chunk 3\n")
    boxes = body[: 2 * 72]
    (tmp_path / "b.ply").write_bytes(more + end + boxes + bytes(72) + body[2 * 72 :])
    expected, actual = read_ply(tmp_path / "a.ply"), read_ply(tmp_path / "b.ply")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name))


def test_too_few_boxes_are_refused(tmp_path):
    write_compressed_ply(tmp_path / "a.ply", scene(300, 1))
    head, end, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    shortened_header = head.replace(b"element chunk 2\n", b"element chunk 1\n")
    (tmp_path / "b.ply").write_bytes(shortened_header + end + body[72:])
    with pytest.raises(HeaderMalformed, match="the element has 1 rows") as caught:
        read_ply(tmp_path / "b.ply")
    assert caught.value.expected == "2 or more"

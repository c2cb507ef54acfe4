"""Arrays of .npy and .npz files come back as they are, and damaged files in one line."""

import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from gsgen.contract.process.array_files import ArraysUnreadable, read_array_file, read_arrays
from support.hostile.motions import MOTIONS, npy_bytes, npy_of, write_motion

# Files that are right for the reader: they are no motions.
READABLE = {
    *("other_names.npz", "nested_names.npz", "no_arrays.npz"),
    *("rate_is_empty.npz", "rate_is_a_text.npz"),
    *("texts.npy", "complex.npy", "not_numbers.npy", "no_axes.npy", "empty.npy", "five_axes.npy"),
}
DAMAGED = [name for name in MOTIONS if name not in READABLE and not name.endswith(".json")]


@pytest.mark.parametrize("name", [*DAMAGED, "pipe.npz"])
def test_a_damaged_file_is_refused_in_one_line_and_little_memory(tmp_path, name):
    path = write_motion(tmp_path, name)
    tracemalloc.start()
    with pytest.raises(ArraysUnreadable) as refused:
        read_array_file(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6
    assert str(refused.value).startswith(f"{path}: cannot be read: ")
    assert "\n" not in str(refused.value)
    assert len(refused.value.message) < 300


@pytest.mark.parametrize("name", sorted(READABLE))
def test_a_right_file_is_read_as_numpy_reads_it(tmp_path, name):
    path = write_motion(tmp_path, name)
    expected = np.load(path)
    if isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(read_array_file(path)[""], expected)
    else:
        arrays = read_arrays(path)
        assert sorted(arrays) == sorted(expected.files)
        for key in arrays:
            np.testing.assert_array_equal(arrays[key], expected[key])


@given(
    array=arrays_of.arrays(
        st.one_of(
            arrays_of.floating_dtypes(), arrays_of.integer_dtypes(), arrays_of.boolean_dtypes()
        ),
        arrays_of.array_shapes(min_dims=0, min_side=0),
    ),
    is_fortran=st.booleans(),
)
def test_arrays_of_every_dtype_shape_and_order_come_back(tmp_path_factory, array, is_fortran):
    folder = tmp_path_factory.mktemp("arrays")
    stored = np.asfortranarray(array) if is_fortran else array
    np.save(folder / "a.npy", stored)
    np.savez(folder / "a.npz", x=stored)
    np.savez_compressed(folder / "b.npz", x=stored)
    for read in (
        read_array_file(folder / "a.npy")[""],
        read_arrays(folder / "a.npz")["x"],
        read_arrays(folder / "b.npz")["x"],
    ):
        assert read.dtype == array.dtype
        np.testing.assert_array_equal(read, array)


def test_named_arrays_alone_are_read(tmp_path):
    """Published files also hold objects, which nobody needs."""
    np.savez(tmp_path / "a.npz", poses=np.ones(3), gender=np.asarray({}, object))
    assert list(read_arrays(tmp_path / "a.npz", ["poses", "absent"])) == ["poses"]
    with pytest.raises(ArraysUnreadable, match="holds object, expected numbers"):
        read_arrays(tmp_path / "a.npz")


def test_arrays_that_share_the_limit_are_counted_together(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in "ab":
            archive.writestr(f"{name}.npy", npy_bytes("(3000000,)", "'|u1'", bytes(3_000_000)))
    assert list(read_arrays(path, ["a"])) == ["a"]
    with pytest.raises(ArraysUnreadable, match="takes more memory than the limit"):
        read_arrays(path)


def test_an_uncompressed_file_of_any_size_is_read(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(5_000_000))
    assert len(read_array_file(path)[""]) == 5_000_000


@given(header=st.text(st.characters(max_codepoint=255), max_size=80), data=st.binary(max_size=64))
def test_any_header_gives_an_array_or_one_line(tmp_path_factory, header, data):
    path: Path = tmp_path_factory.mktemp("arrays") / "a.npy"
    path.write_bytes(npy_of(header, data))
    with pytest.raises(ArraysUnreadable, match="cannot be read: "):
        read_array_file(path)

import numpy as np
import pytest

from gsgen.formats import FormatError, PackedRows, PointCloud, Splats, ValueInvalid


def splats_of(count: int, coefficients: int, **changed: object) -> Splats:
    arrays: dict[str, object] = {
        "position": np.zeros((count, 3), np.float32),
        "rotation": np.zeros((count, 4), np.float32),
        "log_scale": np.zeros((count, 3), np.float32),
        "logit_opacity": np.zeros(count, np.float32),
        "sh": np.zeros((count, coefficients, 3), np.float32),
    }
    return Splats(**(arrays | changed))


@pytest.mark.parametrize(("coefficients", "degree"), [(1, 0), (4, 1), (9, 2), (16, 3), (25, 4)])
def test_degree_follows_from_the_number_of_coefficients(coefficients, degree):
    assert splats_of(2, coefficients).degree == degree


def test_a_prompt_shows_a_line_of_facts_and_no_arrays():
    position = np.float32([[-1, 0, 2], [1, 2.5, 3]])
    splats = splats_of(2, 16, position=position)
    assert repr(splats) == "<Splats: 2 splats, SH degree 3, box (-1, 0, 2) to (1, 2.5, 3), classic>"
    assert repr(splats_of(0, 1)) == "<Splats: 0 splats, SH degree 0, box empty, classic>"
    points = PointCloud(position, np.zeros((2, 3), np.float32))
    assert repr(points) == "<PointCloud: 2 points, box (-1, 0, 2) to (1, 2.5, 3)>"
    rows = PackedRows(np.zeros((1200, 10), np.float16), np.zeros((1200, 27), np.float16))
    assert repr(rows) == "<PackedRows: 1,200 Gaussians, 27 channels of appearance, float16>"


@pytest.mark.parametrize("coefficients", [0, 2, 15, 36])
def test_splats_refuse_coefficients_of_no_degree(coefficients):
    with pytest.raises(ValueInvalid) as caught:
        splats_of(2, coefficients)
    assert str(caught.value) == (
        f"sh: the splats have {coefficients} SH coefficients\nexpected 1, 4, 9, 16 or 25 (degree 0 to 4)"
    )


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        (
            "position",
            np.zeros((2, 4), np.float32),
            "the array is float32 [2, 4]\nexpected float32 [n, 3]",
        ),
        ("position", np.zeros(2, np.float32), "the array is float32 [2]\nexpected float32 [n, 3]"),
        (
            "rotation",
            np.zeros((3, 4), np.float32),
            "the array is float32 [3, 4]\nexpected float32 [2, 4]",
        ),
        ("log_scale", np.zeros((2, 3)), "the array is float64 [2, 3]\nexpected float32 [2, 3]"),
        (
            "logit_opacity",
            np.zeros((2, 1), np.float32),
            "the array is float32 [2, 1]\nexpected float32 [2]",
        ),
        ("sh", [[0.0]], "the value is a list\nexpected float32 [2, k, 3]"),
        (
            "sh",
            np.zeros((2, 3), np.float32),
            "the array is float32 [2, 3]\nexpected float32 [2, k, 3]",
        ),
    ],
)
def test_splats_refuse_an_array_that_does_not_fit(name, value, text):
    with pytest.raises(ValueInvalid) as caught:
        splats_of(2, 1, **{name: value})
    assert str(caught.value) == f"{name}: {text}"


def test_points_refuse_colours_of_another_length():
    with pytest.raises(ValueInvalid) as caught:
        PointCloud(np.zeros((2, 3), np.float32), np.zeros((1, 3), np.float32))
    assert str(caught.value) == "color: the array is float32 [1, 3]\nexpected float32 [2, 3]"


def test_packed_rows_keep_two_data_types():
    packed = PackedRows(np.zeros((2, 10), np.float32), np.zeros((2, 48), np.float16))
    assert (packed.gaussians.dtype, packed.appearance.dtype) == (np.float32, np.float16)
    assert len(packed) == 2


def test_packed_rows_refuse_doubles():
    with pytest.raises(ValueInvalid) as caught:
        PackedRows(np.zeros((2, 10)), np.zeros((2, 3), np.float32))
    assert str(caught.value) == (
        "gaussians: the array is float64 [2, 10]\nexpected float16 or float32 [n, 10]"
    )


def test_an_invalid_value_is_both_a_format_error_and_a_value_error():
    assert issubclass(ValueInvalid, FormatError)
    assert issubclass(ValueInvalid, ValueError)

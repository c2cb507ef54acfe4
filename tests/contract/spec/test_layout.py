import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gsgen.contract.errors import LayoutMismatch
from gsgen.contract.spec.layout import (
    FIELDS,
    ROW_LENGTH,
    DecodedGaussians,
    appearance_channels,
    decode,
    encode,
)

SH = [1, 4, 9, 16]


def floats(shape, **limits):
    return arrays(np.float32, shape, elements=st.floats(width=32, **limits))


@st.composite
def gaussians(draw, **limits):
    n = draw(st.integers(0, 4))
    channels = draw(st.sampled_from([*SH, "rgb"]))
    color = {"rgb": draw(floats((n, 3), **limits))}
    if channels != "rgb":
        color = {"sh": draw(floats((n, channels, 3), **limits))}
    position, covariance = draw(floats((n, 3), **limits)), draw(floats((n, 6), **limits))
    return DecodedGaussians(
        position=position, opacity=draw(floats(n, **limits)), covariance=covariance, **color
    )


def arrays_of(original):
    named = {
        name: getattr(original, name) for name in ("position", "opacity", "covariance", "sh", "rgb")
    }
    return {name: array for name, array in named.items() if array is not None}


def same_layout(original, decoded):
    shapes = [{k: v.shape for k, v in arrays_of(g).items()} for g in (original, decoded)]
    return shapes[0] == shapes[1] and original.degree == decoded.degree


@given(gaussians())
def test_float32_survives_a_round_trip_bit_by_bit(original):
    rows, appearance = encode(original)
    decoded = decode(rows, appearance, "rgb" if original.sh is None else "sh")
    assert rows.dtype == appearance.dtype == np.float32
    assert same_layout(original, decoded)
    for name, array in arrays_of(original).items():
        actual = np.ascontiguousarray(arrays_of(decoded)[name])
        np.testing.assert_array_equal(actual.view(np.uint32), array.view(np.uint32), name)


@given(gaussians(min_value=-65504, max_value=65504))
def test_float16_survives_a_round_trip_within_half_a_unit_in_the_last_place(original):
    rows, appearance = encode(original, np.float16)
    decoded = decode(rows, appearance, "rgb" if original.sh is None else "sh")
    assert rows.dtype == appearance.dtype == np.float16
    assert same_layout(original, decoded)
    for name, array in arrays_of(original).items():
        actual = arrays_of(decoded)[name]
        exponent = np.maximum(np.frexp(actual)[1] - 1, -14)  # below that float16 is subnormal
        unit = 2.0 ** (exponent - 10)
        assert (np.abs(actual.astype(np.float64) - array) <= unit / 2).all(), name


def test_row_order_is_position_opacity_upper_triangle():
    decoded_gaussians = DecodedGaussians(
        position=np.array([[1.0, 2, 3]]),
        opacity=np.array([4.0]),
        covariance=np.array([[5.0, 6, 7, 8, 9, 10]]),
        rgb=np.zeros((1, 3)),
    )
    assert encode(decoded_gaussians)[0].tolist() == [[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]]
    assert ROW_LENGTH == len(FIELDS) == 10
    assert FIELDS[4:] == ("xx", "xy", "xz", "yy", "yz", "zz")


def test_sh_is_coefficient_major_with_rgb_innermost():
    sh = np.arange(12.0).reshape(1, 4, 3)  # coefficient k, channel c holds 3k + c
    decoded_gaussians = DecodedGaussians(
        position=np.zeros((1, 3)), opacity=np.zeros(1), covariance=np.zeros((1, 6)), sh=sh
    )
    assert encode(decoded_gaussians)[1].tolist() == [list(range(12))]
    assert decoded_gaussians.degree == 1
    assert len(decoded_gaussians) == 1


@pytest.mark.parametrize(("dtype", "row"), [("f4", [1, 2, 3]), ("f2", [1, 2, 3, 1])])
def test_rgb_is_padded_with_one_where_it_does_not_fill_words(dtype, row):
    rgb = np.array([[1.0, 2, 3]])
    decoded_gaussians = DecodedGaussians(
        position=np.zeros((1, 3)), opacity=np.zeros(1), covariance=np.zeros((1, 6)), rgb=rgb
    )
    rows, appearance = encode(decoded_gaussians, np.dtype(dtype).type)
    assert appearance.tolist() == [row]
    decoded = decode(rows, appearance, "rgb")
    assert decoded.rgb is not None
    assert decoded.rgb.tolist() == rgb.tolist()
    assert decoded.degree is None


@pytest.mark.parametrize(
    ("space", "degree", "itemsize", "channels"),
    [
        ("sh", 0, 4, 3),
        ("sh", 1, 2, 12),
        ("sh", 2, 4, 27),
        ("sh", 3, 2, 48),
        ("sh", None, 4, 3),
        ("rgb", None, 4, 3),
        ("rgb", None, 2, 4),
    ],
)
def test_appearance_has_the_channels_of_its_space(space, degree, itemsize, channels):
    assert appearance_channels(space, degree, itemsize) == channels


def parts(n=2, **changes):
    defaults = {"position": (n, 3), "opacity": (n,), "covariance": (n, 6), "rgb": (n, 3)}
    shapes = defaults | changes
    return {name: np.zeros(shape) for name, shape in shapes.items() if shape is not None}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"position": (2, 4)}, "Gaussians.position: the shape is [2, 4], expected [2, 3]"),
        ({"opacity": (2, 1)}, "Gaussians.opacity: the shape is [2, 1], expected [2]"),
        ({"covariance": (1, 6)}, "Gaussians.covariance: the shape is [1, 6], expected [2, 6]"),
        ({"rgb": (2, 4)}, "Gaussians.rgb: the shape is [2, 4], expected [2, 3]"),
        (
            {"rgb": None, "sh": (2, 5, 3)},
            "Gaussians.sh: the shape is [2, 5, 3], expected [2, 16, 3]",
        ),
        ({"rgb": None, "sh": (2, 12)}, "Gaussians.sh: the shape is [2, 12], expected [2, 16, 3]"),
        ({"rgb": None}, "Gaussians: give colours as exactly one of sh and rgb"),
        ({"sh": (2, 1, 3)}, "Gaussians: give colours as exactly one of sh and rgb"),
    ],
)
def test_gaussians_of_another_shape_are_refused(changes, text):
    with pytest.raises(LayoutMismatch) as caught:
        DecodedGaussians(**parts(**changes))
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("rows", "appearance", "space", "text"),
    [
        (
            (2, 9),
            (2, 3),
            "rgb",
            "gaussians: the packed Gaussians have shape [2, 9], expected [N, 10]",
        ),
        (
            (1, 2, 10),
            (2, 3),
            "rgb",
            "gaussians: the packed Gaussians have shape [1, 2, 10], expected [N, 10]",
        ),
        (
            (2, 10),
            (2, 5),
            "rgb",
            "appearance: the appearance has shape [2, 5], expected [2, C] with C in (3, 4)",
        ),
        (
            (2, 10),
            (3, 12),
            "sh",
            "appearance: the appearance has shape [3, 12], expected [2, C] with C in (3, 12, 27, 48)",
        ),
        (
            (2, 10),
            (24,),
            "sh",
            "appearance: the appearance has shape [24], expected [2, C] with C in (3, 12, 27, 48)",
        ),
    ],
)
def test_arrays_of_another_shape_are_not_decoded(rows, appearance, space, text):
    with pytest.raises(LayoutMismatch) as caught:
        decode(np.zeros(rows, np.float32), np.zeros(appearance, np.float32), space)
    assert str(caught.value) == text

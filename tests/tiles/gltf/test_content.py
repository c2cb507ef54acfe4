"""What is written is what is measured, and every reader of SPZ decodes every quality."""

import gzip
import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.spec.geometry import covariance_upper, symmetric
from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.formats import Splats
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.quantities import sigmoid
from gsgen.formats.spz import container
from gsgen.tiles.format.index import content_uri, morton
from gsgen.tiles.format.tileset import Z_UP_FROM_Y_UP
from gsgen.tiles.gltf.axes import rotate_splats
from gsgen.tiles.gltf.container import open_content
from gsgen.tiles.gltf.decoding import decode_content, read_header
from gsgen.tiles.gltf.encoding import SPZ_QUALITIES, EncodedContent, write_content
from gsgen.tiles.gltf.placement import PlacedSplats, place
from support.splat_files import scene

SPLAT_ARRAYS = ("position", "rotation", "log_scale", "logit_opacity", "sh")
CENTER = np.array([1200.5, -340.25, 55.0])


def distant_splats(count: int = 400, degree: int = 3, seed: int = 0) -> Splats:
    splats = scene(count, degree, seed)
    return replace(splats, position=(splats.position + CENTER).astype(np.float32))


def decode_tile(encoded: EncodedContent) -> PlacedSplats:
    ((splats, matrix),) = decode_content(open_content(encoded.data, "x"), "x")
    return place(splats, Z_UP_FROM_Y_UP @ matrix)


def sigma(splats: Splats) -> np.ndarray:
    scale = np.exp(splats.log_scale.astype(np.float64))
    return symmetric(covariance_upper(scale, splats.rotation))


def test_khr_content_returns_the_written_floats() -> None:
    splats = distant_splats()
    back = decode_tile(write_content(splats, CENTER, codec="khr"))
    assert np.abs(back.positions() - splats.position.astype(np.float64)).max() < 2e-4
    assert np.abs(sigma(back.splats) - sigma(splats)).max() < 1e-5 * sigma(splats).max()
    assert np.abs(back.splats.logit_opacity - splats.logit_opacity).max() < 1e-4
    direction = np.eye(3)
    apart = evaluate(back.splats.sh, direction) - evaluate(splats.sh, direction)
    assert np.abs(apart).max() < 1e-5


@pytest.mark.parametrize("codec", ["spz", "khr"])
@pytest.mark.parametrize("quality", range(len(SPZ_QUALITIES)))
def test_the_box_is_that_of_what_is_stored(codec, quality: int) -> None:
    """Its corners are those of a reader's own 3σ boxes."""
    encoded = write_content(distant_splats(), CENTER, codec=codec, quality=quality)
    back = decode_tile(encoded)
    reach = 3 * np.sqrt(np.einsum("nii->ni", sigma(back.splats)))
    assert np.allclose((back.positions() - reach).min(axis=0), encoded.low, atol=2e-4)
    assert np.allclose((back.positions() + reach).max(axis=0), encoded.high, atol=2e-4)
    assert encoded.splats == len(back) == 400
    assert encoded.sh_degree == 3


def test_a_lower_quality_is_smaller_and_worse() -> None:
    splats = distant_splats(4000)
    sizes, errors = [], []
    for quality in range(len(SPZ_QUALITIES)):
        encoded = write_content(splats, CENTER, quality=quality)
        sizes.append(len(encoded.data))
        errors.append(np.abs(decode_tile(encoded).positions() - splats.position).max())
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 1.5 * sizes[-1]
    assert errors == sorted(errors)
    small = np.exp(np.quantile(splats.log_scale.max(axis=1), 0.1))
    assert errors[-1] < small  # half a step is a quarter of σ of a small splat, along an axis
    assert errors[0] < 1 / 4096


@pytest.mark.parametrize("quality", range(len(SPZ_QUALITIES)))
def test_the_file_is_spz_version_2_as_the_format_says(quality: int) -> None:
    """Read by hand: header, sizes, and the accessors that viewers allocate by."""
    encoded = write_content(distant_splats(degree=2), CENTER, quality=quality)
    size = struct.unpack_from("<I", encoded.data, 12)[0]
    document = json.loads(encoded.data[20 : 20 + size])
    view = document["bufferViews"][0]
    start = 28 + size + view["byteOffset"]
    packed = encoded.data[start : start + view["byteLength"]]
    assert packed[4:8] == bytes(4)  # no time in gzip
    body = gzip.decompress(packed)
    magic, version, count, degree, fraction = struct.unpack_from("<4sIIBB", body)
    assert (magic, version, count, degree) == (b"NGSP", 2, 400, 2)
    assert len(body) == 16 + 400 * (9 + 1 + 3 + 3 + 3 + 24)
    assert fraction <= 20
    header = read_header(open_content(encoded.data, "x"), "x", len(encoded.data))
    (primitive,) = header.primitives
    assert set(primitive.counts.values()) == {400}
    assert len(primitive.counts) == 4 + 8 + 1
    assert header.extensions_required == (
        "KHR_gaussian_splatting",
        "KHR_gaussian_splatting_compression_spz_2",
    )
    assert len(encoded.data) == struct.unpack_from("<I", encoded.data, 8)[0]


def test_equal_splats_give_equal_bytes() -> None:
    first, second = (write_content(distant_splats(seed=3), CENTER).data for _ in range(2))
    assert first == second
    assert content_uri(2, (1, 2, 3), first) == content_uri(2, (1, 2, 3), second)


@pytest.mark.parametrize("degree", [0, 2])
def test_every_row_stays_whole_when_rows_are_reordered(degree: int) -> None:
    """Any order of the input has the same rows; without harmonics, the same bytes."""
    splats = distant_splats(300, degree)
    reverse = Splats(**{name: getattr(splats, name)[::-1].copy() for name in SPLAT_ARRAYS})
    first, second = (write_content(order, CENTER) for order in (splats, reverse))
    assert (first.data == second.data) is (degree == 0)
    for encoded in (first, second):
        back = decode_tile(encoded)
        distances = np.abs(back.positions()[:, None] - splats.position[None]).max(axis=2)
        source = distances.argmin(axis=1)
        assert sorted(source) == list(range(300))
        apart = np.abs(sigma(back.splats) - sigma(splats)[source]).max(axis=(1, 2))
        assert np.median(apart / sigma(splats)[source].max(axis=(1, 2))) < 0.1
        assert np.abs(back.splats.log_scale - splats.log_scale[source]).max() < 1 / 32 + 1e-5
        opacity = sigmoid(back.splats.logit_opacity) - sigmoid(splats.logit_opacity[source])
        assert np.abs(opacity).max() < 0.01
        assert np.abs(back.splats.sh[:, 0] - splats.sh[source, 0]).max() < 0.06


def test_rows_without_harmonics_are_packed_in_fewer_bytes() -> None:
    """Rows of a wall in random order take a twentieth more, packed in the same way."""
    rng = np.random.default_rng(5)
    wall = np.column_stack([rng.uniform(-9, 9, (4000, 2)), np.zeros(4000)]) + CENTER
    splats = replace(
        distant_splats(4000, 0),
        position=wall.astype(np.float32),
        log_scale=np.full((4000, 3), -2.0, np.float32),
    )
    data = write_content(splats, CENTER, quality=3).data
    size = struct.unpack_from("<I", data, 12)[0]
    view = json.loads(data[20 : 20 + size])["bufferViews"][0]
    frame = container.unpack(data[28 + size :][: view["byteLength"]], 1 << 20)
    order = rng.permutation(4000)
    shuffled = {
        name: np.asarray(stream).reshape(4000, -1)[order].tobytes()
        for name, stream in frame.streams.items()
    }
    assert view["byteLength"] < 0.95 * len(container.pack(frame, shuffled))


def test_content_that_cannot_be_encoded_is_refused() -> None:
    with pytest.raises(ValueInvalid):
        write_content(distant_splats(1), np.array([1e9, 0, 0]))
    with pytest.raises(ValueInvalid):
        write_content(distant_splats(1), CENTER, quality=5)
    empty = scene(0, 0)
    with pytest.raises(ValueInvalid):
        write_content(empty, CENTER)


def test_degree_four_is_cut_to_three() -> None:
    assert write_content(distant_splats(5, degree=4), CENTER).sh_degree == 3


def test_visible_splats_stay_visible() -> None:
    """No opacity above half a step of the finest becomes zero."""
    splats = replace(distant_splats(300), logit_opacity=np.full(300, -5.3, np.float32))  # 0.005
    for quality in range(len(SPZ_QUALITIES)):
        back = decode_tile(write_content(splats, CENTER, quality=quality))
        assert np.isfinite(back.splats.logit_opacity).all()


def test_morton_is_that_of_bits_one_by_one() -> None:
    rng = np.random.default_rng(0)
    for cell in rng.integers(0, 1 << 12, (50, 3)).tolist():
        bits = [
            (cell[axis] >> bit & 1) << (3 * bit + axis) for bit in range(12) for axis in range(3)
        ]
        assert morton(tuple(cell)) == sum(bits)


def test_rotating_agrees_with_colours_and_ellipsoids() -> None:
    rng = np.random.default_rng(2)
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix *= np.sign(np.linalg.det(matrix))
    splats = scene(50, 3)
    turned = rotate_splats(splats, matrix)
    assert np.abs(sigma(turned) - matrix @ sigma(splats) @ matrix.T).max() < 1e-6
    direction = rng.normal(size=(20, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    before, after = (evaluate(splats.sh, direction), evaluate(turned.sh, direction @ matrix.T))
    assert np.abs(before - after).max() < 1e-5


def test_placing_keeps_digits_far_away() -> None:
    splats = scene(100, 0)
    matrix = np.eye(4)
    matrix[:3, 3] = [4e6, 3e6, 4e6]
    expected = splats.position.astype(np.float64) + matrix[:3, 3]
    assert np.abs(place(splats, matrix).positions() - expected).max() < 1e-5

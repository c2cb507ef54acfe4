import itertools

import numpy as np
import pytest
import torch
from torch.nn import functional

from gsgen.sdk import GeneratorInvalid, math

RNG = np.random.default_rng(9)
# Inside, on corners and borders, just and far outside.
EDGES = np.array(list(itertools.product((-1e6, -1.5, -1.01, -1, 0, 0.999, 1, 1.2, 3e9), repeat=2)))
POINTS = np.concatenate([RNG.uniform(-1.3, 1.3, (200, 2)), EDGES]).astype(np.float32)


def bilinear(
    plane: np.ndarray, points: np.ndarray, align_corners: bool, padding: str
) -> np.ndarray:
    """The definition, texel by texel, in float64: the tent-weighted sum of all texels."""
    _, height, width = plane.shape
    results = []
    for u, v in points.astype(np.float64):
        x, y = ((u + 1) / 2, (v + 1) / 2)
        if align_corners:
            x, y = x * (width - 1), y * (height - 1)
        else:
            x, y = x * width - 0.5, y * height - 0.5
        if padding == "border":
            x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
        horizontal = np.maximum(0, 1 - np.abs(np.arange(width) - x))
        down = np.maximum(0, 1 - np.abs(np.arange(height) - y))
        results.append(np.einsum("chw,h,w->c", plane, down, horizontal))
    return np.array(results)


@pytest.mark.parametrize("padding", ["border", "zeros"])
@pytest.mark.parametrize("align_corners", [True, False])
@pytest.mark.parametrize("shape", [(2, 5, 7), (1, 1, 4), (3, 6, 1), (1, 1, 1), (2, 2, 2)])
def test_samples_are_those_of_the_definition_and_of_torch(
    shape: tuple[int, int, int], align_corners: bool, padding: str
) -> None:
    plane = RNG.normal(size=shape).astype(np.float32)
    actual = math.sample_plane(
        torch.from_numpy(plane),
        torch.from_numpy(POINTS),
        align_corners=align_corners,
        padding=padding,
    ).numpy()
    np.testing.assert_allclose(actual, bilinear(plane, POINTS, align_corners, padding), atol=3e-6)
    torch_sample = functional.grid_sample(
        torch.from_numpy(plane)[None],
        torch.from_numpy(POINTS)[None, None],
        padding_mode=padding,
        align_corners=align_corners,
    )[0, :, 0].T
    np.testing.assert_allclose(actual, torch_sample.numpy(), atol=3e-6)


SIZES = (3, 4, 5, 6)  # along x, y, z, t


def field(axes: list[tuple[int, int]]) -> list[np.ndarray]:
    return [RNG.normal(size=(2, SIZES[b], SIZES[a])).astype(np.float32) for a, b in axes]


@pytest.mark.parametrize("combine", ["product", "sum", "concat"])
@pytest.mark.parametrize("count", [3, 6])
def test_planes_are_combined_as_their_papers_do(count: int, combine: str) -> None:
    axes = list(itertools.combinations(range(3 if count == 3 else 4), 2))
    planes = field(axes)
    position, time = RNG.uniform(-1, 1, (30, 3)).astype(np.float32), np.float32([0.3])
    samples = np.concatenate([position, np.full((30, 1), time)], axis=1)
    parts = [
        bilinear(plane, samples[:, [a, b]], True, "border")
        for plane, (a, b) in zip(planes, axes, strict=True)
    ]
    expected = {
        "product": np.prod(parts, axis=0),
        "sum": np.sum(parts, axis=0),
        "concat": np.concatenate(parts, axis=1),
    }[combine]
    tensors = [torch.from_numpy(plane)[None] for plane in planes]  # [1, C, H, W], as stored
    where = torch.from_numpy(position)
    if count == 3:
        actual = math.tri_plane(tensors, where, combine=combine)
    else:
        actual = math.hex_plane(tensors, where, torch.from_numpy(time), combine=combine)
    np.testing.assert_allclose(actual.numpy(), expected, atol=5e-6)


def test_a_box_is_mapped_to_the_unit_cube() -> None:
    low, high = torch.tensor([-1.0, 0, 2]), torch.tensor([1.0, 4, 3])
    result = math.to_unit_cube(torch.stack([low, high, (low + high) / 2]), low, high)
    assert result.tolist() == [[-1, -1, -1], [1, 1, 1], [0, 0, 0]]


def test_other_planes_are_refused() -> None:
    with pytest.raises(GeneratorInvalid, match="5 planes, expected 6"):
        math.hex_plane([torch.ones(1, 2, 2)] * 5, torch.zeros(3, 3), torch.zeros(1))
    with pytest.raises(GeneratorInvalid, match=r"expected \[C, H, W\]"):
        math.sample_plane(torch.zeros(2, 2), torch.zeros(3, 2))

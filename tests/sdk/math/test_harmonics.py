import numpy as np
import pytest
import torch

from gsgen.contract.spec.spherical_harmonics import evaluate
from gsgen.sdk import GeneratorInvalid, math

N = 5


def numbered(k: int) -> np.ndarray:
    """[N, K, 3] whose entries say where they stand: 100 n + 10 k + channel."""
    n, coefficient, channel = np.ogrid[:N, :k, :3]
    return (100 * n + 10 * coefficient + channel).astype(np.float32)


@pytest.mark.parametrize("k", [1, 4, 9, 16])
def test_every_stored_layout_becomes_coefficient_major(k: int) -> None:
    expected = torch.from_numpy(numbered(k))
    by_channel = expected.transpose(1, 2).contiguous()
    for stored in (by_channel, by_channel.flatten(1)):
        assert torch.equal(math.sh_from_channel_major(stored), expected)
    for stored in (expected, expected.flatten(1)):
        assert torch.equal(math.sh_from_coefficient_major(stored), expected)
    # f_rest_0, f_rest_1, … of a PLY: all of red without its constant, then green, then blue.
    columns = [expected[:, index, channel] for channel in range(3) for index in range(1, k)]
    remaining = torch.stack(columns, dim=1) if columns else torch.zeros(N, 0)
    assert torch.equal(math.sh_from_ply(expected[:, 0], remaining), expected)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("stored", [0, 1, 2, 3])
def test_degrees_are_cut_or_filled_with_zeros(stored: int, degree: int) -> None:
    sh = torch.from_numpy(numbered((stored + 1) ** 2)) + 1
    result = math.sh_of_degree(sh, degree)
    shared = min(sh.shape[1], (degree + 1) ** 2)
    assert result.shape == (N, (degree + 1) ** 2, 3)
    assert torch.equal(result[:, :shared], sh[:, :shared])
    assert not result[:, shared:].any()


def test_a_colour_is_the_same_from_everywhere() -> None:
    rgb = np.random.default_rng(2).random((N, 3)).astype(np.float32)
    sh = math.sh_of_degree(math.sh_from_rgb(torch.from_numpy(rgb)), 2).numpy()
    directions = np.array([[0, 0, 1], [1, 0, 0], [0.6, -0.8, 0]])
    actual = evaluate(sh, directions)
    np.testing.assert_allclose(actual, np.repeat(rgb[:, None], 3, axis=1), atol=1e-6)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: math.sh_from_channel_major(torch.zeros(5, 4, 3)), "shape is [5, 4, 3]"),
        (lambda: math.sh_from_channel_major(torch.zeros(5, 46)), "expected [N, 3, K]"),
        (lambda: math.sh_from_coefficient_major(torch.zeros(5, 3, 4)), "expected [N, K, 3]"),
        (lambda: math.sh_from_coefficient_major(torch.zeros(5, 21)), "K = 1, 4, 9 or 16"),
        (lambda: math.sh_from_ply(torch.zeros(5, 3), torch.zeros(5, 48)), "[N, 45]"),
        (lambda: math.sh_of_degree(torch.zeros(5, 4, 3), 4), "degree is 4, expected 0 to 3"),
    ],
)
def test_other_shapes_are_refused(call, words: str) -> None:
    with pytest.raises(GeneratorInvalid) as caught:
        call()
    assert words in str(caught.value)

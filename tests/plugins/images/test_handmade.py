"""Networks whose weights are set by formula do what they are said to do."""

from pathlib import Path

import pytest
import torch

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.images import denoiser_plugin, stylise_plugin
from gsgen.reference_plugins.synthetic import write_denoiser, write_stylise


def disc() -> torch.Tensor:
    """A disc on black, red on the left and blue on the right, 1 × 3 × 64 × 64."""
    offsets = torch.arange(64.0) - 31.5
    inside = (offsets[:, None] ** 2 + offsets[None] ** 2 < 18**2).float()
    red, blue = torch.tensor([0.9, 0.2, 0.1]), torch.tensor([0.1, 0.2, 0.9])
    left_half = (offsets < 0).float()
    return (red[:, None] * left_half + blue[:, None] * (1 - left_half))[None, :, None, :] * inside


def hills() -> torch.Tensor:
    """Soft colours without an edge, 1 × 3 × 64 × 64."""
    wave = torch.sin(torch.arange(64.0) / 9)
    return torch.stack([0.5 + 0.2 * wave[:, None] * wave, 0.4 + 0.2 * wave.tile(64, 1),
                        0.6 - 0.2 * wave.tile(64, 1).T])[None]  # fmt: skip


def test_the_denoiser_takes_off_the_noise_of_its_timestep(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path, smoothing=True)
    model = denoiser_plugin.build(folder, size="64x64", values="unit", timestep=60)
    signal_share, noise_share = model.fixed_shares
    noise = torch.randn(1, 3, 64, 64, generator=torch.Generator().manual_seed(1))
    noisy = ((2 * hills() - 1) * signal_share + noise_share * noise).clamp(-1, 1) * 0.5 + 0.5
    before, after = ((image - hills()).square().mean() for image in (noisy, model(noisy)))
    assert after < 0.4 * before  # 4 dB
    random = denoiser_plugin.build(
        write_denoiser(tmp_path / "random"), size="64x64", values="unit", timestep=60
    )
    assert (random(noisy) - hills()).square().mean() > before


def test_the_denoiser_keeps_what_has_no_noise(tmp_path: Path) -> None:
    folder = write_denoiser(tmp_path, smoothing=True)
    model = denoiser_plugin.build(folder, size="64x64", values="unit", timestep=1)
    assert (model(disc()) - disc()).abs().max() < 0.05


def test_stylised_drawing_has_colors_and_dark_outline_on_white(tmp_path: Path) -> None:
    model = stylise_plugin.build(write_stylise(tmp_path, drawing=True), size="64x64")
    image = disc()
    drawn = model.eval()(image, torch.ones(1))[0]
    assert (drawn[:, 2:6, 2:6] > 0.85).all()  # paper
    for columns, strong_colors, weak_colors in ((slice(20, 24), 0, 2), (slice(40, 44), 2, 0)):
        color = drawn[:, 30:34, columns].mean(dim=(1, 2))
        assert color[strong_colors] > 0.9
        assert color[weak_colors] < 0.3
    edge = drawn[:, 30:34, 8:20].amax(dim=0).amin()
    assert edge < 0.5  # darker than both sides of it
    assert torch.equal(model(image, torch.zeros(1)), image)


def test_networks_of_another_shape_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match="unsupported options for weights by formula"):
        write_denoiser(tmp_path, latent=True, smoothing=True)
    with pytest.raises(ConfigInvalid, match="5 channels, expected at least 6"):
        write_stylise(tmp_path, channels=5, drawing=True)

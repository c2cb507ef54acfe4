"""Networks of pictures in float64, with NumPy alone: convolutions, norms, attention."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

State = dict[str, np.ndarray]


def convolve(state: State, name: str, x: np.ndarray, stride: int = 1) -> np.ndarray:
    """Convolve pictures [v, c, h, w] with zeros around them."""
    weight = state[f"{name}.weight"]
    side = weight.shape[-1]
    border = side // 2
    padded = np.pad(x, ((0, 0), (0, 0), (border, border), (border, border)))
    windows = sliding_window_view(padded, (side, side), axis=(2, 3))[:, :, ::stride, ::stride]
    return np.einsum("vchwij,ocij->vohw", windows, weight, optimize=True) + state[
        f"{name}.bias"
    ].reshape(-1, 1, 1)


def normalise(state: State, name: str, x: np.ndarray, groups: int, epsilon: float) -> np.ndarray:
    """Normalise groups of channels to mean 0 and variance 1, then scale and shift each channel."""
    grouped = x.reshape(len(x), groups, -1)
    mean = grouped.mean(axis=2, keepdims=True)
    variance = ((grouped - mean) ** 2).mean(axis=2, keepdims=True)
    flat = ((grouped - mean) / np.sqrt(variance + epsilon)).reshape(x.shape)
    return flat * state[f"{name}.weight"].reshape(-1, 1, 1) + state[f"{name}.bias"].reshape(
        -1, 1, 1
    )


def silu(x: np.ndarray) -> np.ndarray:
    return x / (1 + np.exp(-x))


def softmax(scores: np.ndarray) -> np.ndarray:
    powers = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return powers / powers.sum(axis=-1, keepdims=True)


def halved(x: np.ndarray) -> np.ndarray:
    return (x[..., ::2, ::2] + x[..., 1::2, ::2] + x[..., ::2, 1::2] + x[..., 1::2, 1::2]) / 4


def doubled(x: np.ndarray) -> np.ndarray:
    return x.repeat(2, axis=-1).repeat(2, axis=-2)


def song_unet(state: State, pictures: np.ndarray, code: np.ndarray | None = None) -> np.ndarray:
    """Return what Splatter Image's U-Net computes; layers follow from the names of the weights."""

    def norm(name: str, x: np.ndarray) -> np.ndarray:
        return normalise(state, name, x, min(32, x.shape[1] // 4), 1e-6)

    def block(name: str, x: np.ndarray) -> np.ndarray:
        resamplings = {"up": doubled, "down": halved}
        resample = resamplings.get(name.rpartition("_")[2], lambda features: features)
        has_skip = f"{name}.skip.weight" in state
        residual = convolve(state, f"{name}.skip", resample(x)) if has_skip else resample(x)
        x = convolve(state, f"{name}.conv0", resample(silu(norm(f"{name}.norm0", x))))
        if embedding is not None:
            shift = embedding @ state[f"{name}.affine.weight"].T + state[f"{name}.affine.bias"]
            x = silu(norm(f"{name}.norm1", x + shift[:, :, None, None]))
        x = convolve(state, f"{name}.conv1", silu(norm(f"{name}.norm1", x)))
        x = (x + residual) / np.sqrt(2)
        if f"{name}.qkv.weight" not in state:
            return x
        # All pictures below each other.
        count, channels, height, width = x.shape
        tall = x.transpose(1, 0, 2, 3).reshape(1, channels, count * height, width)
        projected = convolve(state, f"{name}.qkv", norm(f"{name}.norm2", tall))
        query, key, value = projected.reshape(channels, 3, -1).transpose(1, 0, 2)
        attended = value @ softmax(query.T @ key / np.sqrt(channels)).T
        tall = (convolve(state, f"{name}.proj", attended.reshape(tall.shape)) + tall) / np.sqrt(2)
        return tall.reshape(channels, count, height, width).transpose(1, 0, 2, 3)

    embedding = None
    if code is not None:
        embedding = code
        for layer in ("map_layer0", "map_layer1"):
            embedding = silu(embedding @ state[f"{layer}.weight"].T + state[f"{layer}.bias"])
    encoder, decoder = (
        list(
            dict.fromkeys(".".join(name.split(".")[:2]) for name in state if name.startswith(part))
        )
        for part in ("enc.", "dec.")
    )
    x, skips = pictures, []
    for name in encoder:
        x = convolve(state, name, x) if name.endswith("_conv") else block(name, x)
        skips.append(x)
    for name in decoder:
        if "_aux_" in name:
            continue
        if "_block" in name:
            x = np.concatenate([x, skips.pop()], axis=1)
        x = block(name, x)
    last = decoder[-1].removesuffix("_aux_conv")
    return convolve(state, f"{last}_aux_conv", silu(norm(f"{last}_aux_norm", x)))


def multi_view_unet(state: State, pictures: np.ndarray) -> np.ndarray:
    """Return what LGM's U-Net computes; layers follow from the names of the weights."""

    def norm(name: str, x: np.ndarray) -> np.ndarray:
        return normalise(state, name, x, 32, 1e-5)

    def residual(name: str, x: np.ndarray) -> np.ndarray:
        has_shortcut = f"{name}.shortcut.weight" in state
        shortcut = convolve(state, f"{name}.shortcut", x) if has_shortcut else x
        x = convolve(state, f"{name}.conv1", silu(norm(f"{name}.norm1", x)))
        x = convolve(state, f"{name}.conv2", silu(norm(f"{name}.norm2", x)))
        return (x + shortcut) / np.sqrt(2)

    def attend(name: str, x: np.ndarray) -> np.ndarray:
        if f"{name}.norm.weight" not in state:
            return x
        channels = x.shape[1]
        tokens = norm(f"{name}.norm", x).transpose(0, 2, 3, 1).reshape(-1, channels)
        query, key, value = np.split(tokens @ state[f"{name}.attn.qkv.weight"].T, 3, axis=1)
        heads = []
        for part in np.split(np.arange(channels), 16):
            scores = query[:, part] @ key[:, part].T / np.sqrt(len(part))
            heads.append(softmax(scores) @ value[:, part])
        attended = np.concatenate(heads, axis=1) @ state[f"{name}.attn.proj.weight"].T
        attended = (attended + state[f"{name}.attn.proj.bias"]).reshape(len(x), *x.shape[2:], -1)
        return (attended.transpose(0, 3, 1, 2) + x) / np.sqrt(2)

    def count(name: str) -> int:
        return len({key.split(".")[1] for key in state if key.startswith(f"{name}.")})

    x = convolve(state, "conv_in", pictures)
    skips = [x]
    for level in range(count("down_blocks")):
        for layer in range(2):
            x = residual(f"down_blocks.{level}.nets.{layer}", x)
            x = attend(f"down_blocks.{level}.attns.{layer}", x)
            skips.append(x)
        if f"down_blocks.{level}.downsample.weight" in state:
            x = convolve(state, f"down_blocks.{level}.downsample", x, stride=2)
            skips.append(x)
    x = residual("mid_block.nets.0", x)
    x = residual("mid_block.nets.1", attend("mid_block.attns.0", x))
    for level in range(count("up_blocks")):
        for layer in range(3):
            x = residual(
                f"up_blocks.{level}.nets.{layer}", np.concatenate([x, skips.pop()], axis=1)
            )
            x = attend(f"up_blocks.{level}.attns.{layer}", x)
        if f"up_blocks.{level}.upsample.weight" in state:
            x = convolve(state, f"up_blocks.{level}.upsample", doubled(x))
    return convolve(state, "conv_out", silu(norm("norm_out", x)))

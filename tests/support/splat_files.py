"""Splats and files of them: random scenes, and writers of formats that are only read."""

import json
import struct
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np

from gsgen.formats import Splats, write_compressed_ply, write_glb, write_ply, write_sog, write_spz
from gsgen.formats import write_splat as write_splat_file

GOLDENS = Path(__file__).parents[1] / "formats" / "goldens"
FIELDS = ("position", "rotation", "log_scale", "logit_opacity", "sh")


def scene(count: int, degree: int, seed: int = 0, **flags: object) -> Splats:
    """Splats as a training leaves them: small, of all turns and opacities."""
    rng = np.random.default_rng(seed)

    def draw(*shape: int, size: float = 1.0, middle: float = 0.0) -> np.ndarray:
        values = middle + size * rng.standard_normal((count, *shape))
        return values.astype(np.float32)

    return Splats(
        position=draw(3, size=3.0),
        rotation=draw(4),
        log_scale=draw(3, size=0.7, middle=-4.0),
        logit_opacity=draw(size=2.0),
        sh=draw((degree + 1) ** 2, 3, size=0.25),
        **flags,  # type: ignore[arg-type]
    )


def unit(rotation: np.ndarray) -> np.ndarray:
    double_precision = rotation.astype(np.float64)
    return double_precision / np.linalg.norm(double_precision, axis=1, keepdims=True)


def opacity(splats: Splats) -> np.ndarray:
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-splats.logit_opacity.astype(np.float64)))


def turn_between(array: np.ndarray, other: np.ndarray) -> float:
    """The largest difference of unit quaternions, of which q and −q are one rotation."""
    a, b = unit(array), unit(other)
    apart = np.minimum(np.abs(a - b).max(axis=1), np.abs(a + b).max(axis=1))
    return float(apart.max())


def assert_near(
    splats: Splats,
    other: Splats,
    *,
    position: float = 0.0,
    rotation: float = 1e-6,
    log_scale: float = 0.0,
    opacities: float = 1e-6,
    sh: float = 0.0,
) -> None:
    """Compare splats row by row; each number is the largest difference that there may be."""
    assert len(splats) == len(other)
    assert splats.degree == other.degree
    close(splats.position, other.position, position)
    assert turn_between(splats.rotation, other.rotation) <= rotation
    close(splats.log_scale, other.log_scale, log_scale)
    close(opacity(splats), opacity(other), opacities)
    close(splats.sh, other.sh, sh)


def close(array: np.ndarray, other: np.ndarray, most: float) -> None:
    assert float(np.abs(array.astype(np.float64) - other).max(initial=0)) <= most


KSPLAT_RECORDS = ("<f4", "<f2", "<f2"), ("<f4", "<f2", "u1")


def ksplat(splats: Splats, level: int, *, bucket_size: int = 8, block: float = 50.0) -> bytes:
    """A KSPLAT file of one section, written value by value.

    Above level 0 the first splats fill a bucket; the others are in buckets of one or two.
    """
    count, degree = len(splats), min(splats.degree, 2)
    full = 1 if level and count >= bucket_size else 0
    lengths = []
    while level and bucket_size * full + sum(lengths) < count:
        lengths.append(min(2, count - bucket_size * full - sum(lengths)))
    sizes = [bucket_size] * full + lengths
    starts = np.cumsum([0, *sizes])[:-1]
    middles = [
        splats.position[offset : offset + size].mean(axis=0)
        for offset, size in zip(starts, sizes, strict=True)
    ]
    body = b"".join(struct.pack("<I", length) for length in lengths)
    body += b"".join(struct.pack("<3f", *middle) for middle in middles)
    bucket = np.repeat(np.arange(len(sizes)), sizes)
    for row in range(count):
        middle = middles[bucket[row]] if level else np.zeros(3)
        body += _ksplat_record(splats, row, middle, level, degree, block)
    header = struct.pack("<BBHIIIIHH", 0, 1, 0, 1, 1, count, count, level, 0)
    header += struct.pack("<3f2f", 0, 0, 0, -1.5, 1.5)
    section = struct.pack("<4If", count, count, bucket_size, len(sizes), block)
    section += struct.pack("<HHIIII", 12, 0, 32767 if level else 1, len(body), full, len(lengths))
    section += struct.pack("<H", degree)
    return header.ljust(4096, b"\0") + section.ljust(1024, b"\0") + body


def _ksplat_record(
    splats: Splats, row: int, middle: np.ndarray, level: int, degree: int, block: float
) -> bytes:
    scale = np.exp(splats.log_scale[row].astype(np.float64))
    turn = unit(splats.rotation[row : row + 1])[0]
    if level:
        steps = (splats.position[row] - middle) / (block / 2 / 32767) + 32767
        out = struct.pack("<3H", *np.rint(np.clip(steps, 0, 65535)).astype(int))
        out += struct.pack("<7e", *scale, *turn)
    else:
        out = struct.pack("<10f", *splats.position[row], *scale, *turn)
    shown = 0.5 + 0.28209479177387814 * splats.sh[row, 0]
    rgba = [*shown, opacity(splats)[row]]
    out += bytes(np.rint(np.clip(rgba, 0, 1) * 255).astype(int).tolist())
    for first, last in [(1, 4), (4, 9)][:degree]:
        values = splats.sh[row, first:last].T.ravel()  # all of red, then green, then blue
        if level == 0:
            out += struct.pack(f"<{len(values)}f", *values)
        elif level == 1:
            out += struct.pack(f"<{len(values)}e", *values)
        else:
            share = np.clip((values + 1.5) / 3, 0, 1)
            out += bytes(np.rint(share * 255).astype(int).tolist())
    return out


def webp(pixels: np.ndarray, width: int) -> bytes:
    """A lossless WebP of rows of RGBA, the last one filled up."""
    from PIL import Image

    rows = -(-len(pixels) // width)
    full = np.zeros((rows * width, 4), np.uint8)
    full[: len(pixels)] = pixels
    stream = BytesIO()
    image = Image.fromarray(full.reshape(rows, width, 4))
    image.save(stream, "WEBP", lossless=True, exact=True, method=0)
    return stream.getvalue()


def sog_files(count: int = 10, bands: int = 1, seed: int = 0, width: int = 4) -> dict[str, bytes]:
    """The files of a SOG of random bytes, whose harmonics come from a palette of 65."""
    rng = np.random.default_rng(seed)

    def image(name: str, rows: int = count, width: int = width) -> bytes:
        pixels = rng.integers(0, 256, (rows, 4))
        if name == "quats":
            pixels[:, 3] = rng.integers(252, 256, rows)
        if name == "labels":
            label = rng.integers(0, 65, rows)
            pixels = np.stack([label & 255, label >> 8, 0 * label, 0 * label + 255], 1)
        if name != "sh0" and name not in ("quats", "labels"):
            pixels[:, 3] = 255
        return webp(pixels, width)

    def book() -> list[float]:
        return np.sort(rng.standard_normal(256)).tolist()

    sh_count = (bands + 1) ** 2 - 1
    meta = {
        "version": 2,
        "count": count,
        "means": {"mins": [-1, -2, -3], "maxs": [1, 2, 3], "files": ["l.webp", "u.webp"]},
        "scales": {"codebook": book(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": book(), "files": ["sh0.webp"]},
    }
    files = {f"{n}.webp": image(n) for n in ("l", "u", "scales", "quats", "sh0")}
    if bands:
        meta["shN"] = {
            "count": 65,
            "bands": bands,
            "codebook": book(),
            "files": ["centroids.webp", "labels.webp"],
        }
        files["centroids.webp"] = image("centroids", 64 * sh_count * 2, 64 * sh_count)
        files["labels.webp"] = image("labels")
    return {"meta.json": json.dumps(meta).encode(), **files}


def sog_version_1(files: dict[str, bytes]) -> dict[str, bytes]:
    """The same images as a SOG of version 1: ranges take the place of codebooks."""
    meta = json.loads(files["meta.json"])
    count = meta.pop("count")
    del meta["version"]
    ranges = {"scales": 3, "sh0": 4, "shN": 1}
    for number, (name, width) in enumerate(ranges.items()):
        if name not in meta:
            continue
        least = [-3 - number + 0.1 * channel for channel in range(width)]
        most = [2 + number - 0.3 * channel for channel in range(width)]
        scalar = name == "shN"
        meta[name] = {
            "mins": least[0] if scalar else least,
            "maxs": most[0] if scalar else most,
            "files": meta[name]["files"],
        }
    for name in meta:
        meta[name] |= {"shape": [count, 3], "dtype": "float32"}
    meta["quats"]["encoding"] = "quaternion_packed"
    return files | {"meta.json": json.dumps(meta).encode()}


def zipped(files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def samples(folder: Path) -> dict[str, list[bytes]]:
    """A few whole files of every format, for what mutates them."""
    splats, original = scene(12, 1, antialiased=True), scene(5, 0, seed=1)
    file = folder / "sample"

    def written(write: object, *args: object, **options: object) -> bytes:
        write(file, *args, **options)  # type: ignore[operator]
        return file.read_bytes()

    encodings = ("ascii", "binary_little_endian", "binary_big_endian")
    result = {
        "ply": [written(write_ply, splats, format=name) for name in encodings],
        "compressed-ply": [
            written(write_compressed_ply, scene_splats) for scene_splats in (splats, original)
        ],
        "splat": [written(write_splat_file, splats)],
        "spz": [
            *(written(write_spz, splats, version=version) for version in (1, 2, 3, 4)),
            written(write_spz, original, version=4),
        ],
        "glb": [written(write_glb, splats)],
        "ksplat": [ksplat(splats, level) for level in (0, 1, 2)],
        "sog": [
            zipped(sog_files()),
            zipped(sog_files(bands=0), zipfile.ZIP_DEFLATED),
            zipped(sog_version_1(sog_files())),
            written(write_sog, splats),
        ],
        "checkpoint": [*checkpoints(original).values(), *checkpoints(splats).values()],
        "npz": [_npz()],
    }
    file.unlink()
    return result


def checkpoints(splats: Splats) -> dict[str, bytes]:
    """The files of gsplat, splatfacto and the 3DGS training code that hold ``splats``."""
    import torch

    def tensor(array: np.ndarray) -> object:
        return torch.nn.Parameter(torch.from_numpy(array.copy()))

    means, quats, scales = map(tensor, (splats.position, splats.rotation, splats.log_scale))
    opacities, column = tensor(splats.logit_opacity), tensor(splats.logit_opacity[:, None])
    sh = torch.from_numpy(splats.sh.copy())  # the first and the others are views of one storage
    gsplat = torch.nn.ParameterDict(
        {"means": means, "scales": scales, "quats": quats, "opacities": opacities}
        | {"sh0": sh[:, :1], "shN": sh[:, 1:]}
    )
    model = torch.nn.Module()
    model.gauss_params = torch.nn.ParameterDict(
        {"means": means, "scales": scales, "quats": quats, "opacities": column}
        | {"features_dc": sh[:, 0], "features_rest": sh[:, 1:]}
    )
    pipeline = torch.nn.Module()
    pipeline._model = model
    optimizer = torch.optim.Adam([{"params": [means], "lr": 0.1, "name": "xyz"}], eps=1e-15)
    means.sum().backward()
    optimizer.step()
    means.data[:] = torch.from_numpy(splats.position)  # the step has moved them
    dc, sh_rest = tensor(splats.sh[:, :1]), tensor(splats.sh[:, 1:])
    statistics = (torch.zeros(len(splats)), torch.zeros(len(splats), 1), torch.ones(len(splats), 1))
    capture = (splats.degree, means, dc, sh_rest, scales, quats, column)
    nerfstudio = {"step": 29_999, "pipeline": pipeline.state_dict(), "scalers": {}}
    saved = {
        "gsplat": {"step": 29_999, "splats": gsplat.state_dict()},
        "nerfstudio": nerfstudio | {"optimizers": {"means": optimizer.state_dict()}},
        "inria": ((*capture, *statistics, optimizer.state_dict(), np.float64(4.5)), 30_000),
    }
    return {name: torch_saved(content) for name, content in saved.items()}


def torch_saved(content: object) -> bytes:
    """What ``torch.save`` writes."""
    import torch

    stream = BytesIO()
    torch.save(content, stream)
    return stream.getvalue()


def _npz() -> bytes:
    stream = BytesIO()
    np.savez_compressed(
        stream, gaussians=np.ones((4, 10), np.float32), appearance=np.ones((4, 3), np.float32)
    )
    return stream.getvalue()

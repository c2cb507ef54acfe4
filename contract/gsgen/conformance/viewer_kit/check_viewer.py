"""Compare the pictures of a viewer with those of a viewer test kit; needs only NumPy.

    python check_viewer.py PICTURES [--kit KIT] [--html page.html] [--json result.json]

A picture of frame N of a case is PICTURES/CASE-N.npy or CASE-N.png: what the screen shows over
black, [height, width, 3 or 4]. Floats of four channels are multiplied by alpha; PNGs are not.
Exits 0 if all cases pass, 1 if one fails, 2 if a file cannot be read.
"""

import argparse
import base64
import html
import json
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np

RESULT_SCHEMA = "gsgen-viewer-kit-result/1"
INDEX_SCHEMA = "gsgen-viewer-kit/1"

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
_MAX_BYTES = 64 << 20
_SHOWN_GAIN = 4.0  # of differences on the page


class KitUnreadable(ValueError):
    """Raised if a viewer test kit or the folder of the viewer's pictures cannot be read."""


class PictureUnreadable(ValueError):
    """Raised if a viewer's picture is missing or cannot be read."""


def check_viewer(kit: Path, pictures: Path) -> dict[str, Any]:
    """Compare a viewer's pictures with the expected pictures of a viewer test kit.

    Returns:
        The result as docs describe it: verdict, cases with their frames, and suspected faults.
    """
    index = read_index(kit)
    if not pictures.is_dir():
        raise KitUnreadable(f"{pictures}: is not a folder, expected that of the viewer's pictures")
    cases = [_check_case(kit, pictures, case, index["tolerance"]) for case in index["cases"]]
    failed = {case["name"] for case in cases if case["verdict"] == "failed"}
    return {
        "schema": RESULT_SCHEMA,
        "verdict": "failed" if failed else "passed",
        "counts": {"passed": len(cases) - len(failed), "failed": len(failed)},
        "tolerance": index["tolerance"],
        "faults": suspected_faults(index, failed),
        "cases": cases,
    }


def read_index(kit: Path) -> dict[str, Any]:
    """Read the index.json of a viewer test kit, which lists test cases, faults and tolerance."""
    path = kit / "index.json"
    try:
        index = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise KitUnreadable(
            f"{path}: cannot be read as the index of a viewer test kit: {error}"
        ) from error
    schema = index.get("schema") if isinstance(index, dict) else None
    if schema != INDEX_SCHEMA:
        raise KitUnreadable(f"{path}: the schema is {schema!r}, expected {INDEX_SCHEMA!r}")
    return dict(index)


def read_expected(kit: Path, name: str) -> np.ndarray:
    """Read an expected picture of a viewer test kit as floats [h, w, 3]."""
    path = kit / "expected" / f"{name}.npy"
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise KitUnreadable(f"{path}: the expected picture cannot be read: {error}") from error


def suspected_faults(index: dict[str, Any], failed: set[str]) -> list[dict[str, Any]]:
    """Return viewer faults whose test cases all failed, except subsets of another such fault."""
    whole = {
        fault["id"]: set(fault["cases"])
        for fault in index["faults"]
        if fault["cases"] and failed.issuperset(fault["cases"])
    }
    return [
        fault
        for fault in index["faults"]
        if fault["id"] in whole and not any(whole[fault["id"]] < cases for cases in whole.values())
    ]


def _check_case(
    kit: Path, pictures: Path, case: dict[str, Any], tolerance: dict[str, float]
) -> dict[str, Any]:
    frames = [_check_frame(kit, pictures, frame, tolerance) for frame in case["frames"]]
    passed = all(frame["verdict"] == "passed" for frame in frames)
    return {
        "name": case["name"],
        "verdict": "passed" if passed else "failed",
        "tests": case["tests"],
        "frames": frames,
    }


def _check_frame(
    kit: Path, pictures: Path, frame: dict[str, Any], tolerance: dict[str, float]
) -> dict[str, Any]:
    name = frame["picture"]
    expected = read_expected(kit, name)
    try:
        actual = read_picture(pictures, name)
        if actual.shape != expected.shape:
            raise PictureUnreadable(
                f"{name}: the picture is {actual.shape[1]}×{actual.shape[0]} pixels, "
                f"expected {expected.shape[1]}×{expected.shape[0]}"
            )
    except PictureUnreadable as error:
        return {"picture": name, "verdict": "failed", "problem": str(error)}
    return {"picture": name, **compare(expected, actual, tolerance)}


def compare(
    expected: np.ndarray, actual: np.ndarray, tolerance: dict[str, float]
) -> dict[str, Any]:
    """Compare two pictures [h, w, 3]; return the differences, and whether the tolerance holds.

    The picture fails if more than ``share`` of its pixels differ by more than ``pixel`` in some
    channel, or if its mean difference is above ``mean``. NaN differs from everything.
    """
    difference = np.nan_to_num(np.abs(actual - expected), nan=1.0, posinf=1.0)
    worst = difference.max(axis=2)
    share = float((worst > tolerance["pixel"]).mean())
    mean = float(difference.mean())
    passed = share <= tolerance["share"] and mean <= tolerance["mean"]
    return {
        "verdict": "passed" if passed else "failed",
        "max": float(worst.max()),
        "mean": mean,
        "share": share,
    }


def read_picture(folder: Path, name: str) -> np.ndarray:
    """Read a viewer's picture from .npy or .png as floats [h, w, 3], composited over black."""
    array_path, image_path = folder / f"{name}.npy", folder / f"{name}.png"
    path = array_path if array_path.is_file() else image_path
    if not path.is_file():
        raise PictureUnreadable(
            f"{name}: the picture is missing: expected {array_path.name} or {image_path.name}"
        )
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise PictureUnreadable(f"the file is larger than the limit of {_MAX_BYTES:,} bytes")
        if path is image_path:
            return _over_black(decode_png(path.read_bytes()))
        array = np.load(path, allow_pickle=False)
    except PictureUnreadable as error:
        raise PictureUnreadable(f"{path}: {error}") from error
    except (OSError, ValueError, EOFError, KeyError, zlib.error, struct.error) as error:
        raise PictureUnreadable(f"{path}: the picture cannot be read: {error!r}") from error
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype.kind != "f":
        raise PictureUnreadable(
            f"{path}: the array is {array.dtype}{list(array.shape)}, "
            "expected floats [height, width, 3 or 4]"
        )
    return np.asarray(np.clip(array[..., :3], 0, 1), np.float64)


def _over_black(picture: np.ndarray) -> np.ndarray:
    """Composite an 8-bit image, grey or RGB, with or without straight alpha, over black."""
    values = picture.astype(np.float64) / 255
    if values.shape[2] in (2, 4):
        values = values[..., :-1] * values[..., -1:]
    return np.array(np.broadcast_to(values, (*values.shape[:2], 3)))


def decode_png(raw: bytes) -> np.ndarray:
    """Decode an 8-bit PNG, without palette or interlacing, to uint8 [h, w, c]."""
    if raw[:8] != _PNG_MAGIC:
        raise PictureUnreadable(f"the picture is not a PNG, but starts with {raw[:8]!r}")
    chunks: dict[bytes, bytes] = {}
    offset = 8
    while offset + 8 <= len(raw):
        length, kind = struct.unpack_from(">I4s", raw, offset)
        chunks[kind] = chunks.get(kind, b"") + raw[offset + 8 : offset + 8 + length]
        offset += length + 12
    width, height, depth, color, _, _, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if depth != 8 or color not in _CHANNELS or interlace:
        raise PictureUnreadable(
            f"the PNG has depth {depth}, colour type {color}, interlace {interlace}; "
            "expected 8 bits of grey or RGB, not interlaced"
        )
    size = width * _CHANNELS[color]
    if (size + 1) * height > _MAX_BYTES:
        raise PictureUnreadable(
            f"the picture of {width}×{height} pixels takes {(size + 1) * height:,} bytes, "
            f"expected at most {_MAX_BYTES:,}"
        )
    inflated = zlib.decompressobj().decompress(chunks[b"IDAT"], (size + 1) * height)
    lines = np.frombuffer(inflated, np.uint8).reshape(height, size + 1)
    return _unfiltered(lines, _CHANNELS[color]).reshape(height, width, _CHANNELS[color])


def _unfiltered(lines: np.ndarray, step: int) -> np.ndarray:
    """Undo the filters of PNG lines; the first byte of each line is its filter type."""
    result = np.zeros((len(lines) + 1, lines.shape[1] - 1 + step), np.int32)  # a margin of zeros
    for y in range(1, len(result)):
        method, line, above = lines[y - 1, 0], lines[y - 1, 1:], result[y - 1]
        current = result[y]
        for i in range(len(line)):
            left, up, corner = int(current[i]), int(above[i + step]), int(above[i])
            guess = _predicted(int(method), left, up, corner)
            current[i + step] = (int(line[i]) + guess) & 255
    return result[1:, step:].astype(np.uint8)


def _predicted(method: int, left: int, up: int, corner: int) -> int:
    if method < 4:
        return (0, left, up, (left + up) // 2)[method]
    if method > 4:
        raise PictureUnreadable(f"a PNG line has filter type {method}, expected 0 to 4")
    estimate = left + up - corner
    return min((left, up, corner), key=lambda value: abs(estimate - value))


def encode_png(picture: np.ndarray) -> bytes:
    """Encode floats [h, w, 3] in [0, 1] as an 8-bit RGB PNG."""
    values = np.rint(np.clip(np.nan_to_num(picture), 0, 1) * 255).astype(np.uint8)
    height, width = values.shape[:2]
    lines = np.concatenate([np.zeros((height, 1), np.uint8), values.reshape(height, -1)], axis=1)
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b""))
    return _PNG_MAGIC + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
  color: #1c2024; background: #fff }
h1 { font-size: 1.5rem } h2 { font-size: 1.05rem; margin: 2rem 0 .2rem }
.passed b { color: #1a7f37 } .failed b { color: #b3261e }
.frame { display: flex; flex-wrap: wrap; gap: .8rem; margin: .5rem 0 }
figure { margin: 0 } figcaption { color: #60646c; font-size: .8rem }
img { width: 256px; image-rendering: pixelated; background: #000; display: block }
p { margin: .2rem 0 } .fault { border-left: 3px solid #b3261e; padding-left: .7rem }
"""


def page_of(kit: Path, pictures: Path, result: dict[str, Any]) -> str:
    """Return an HTML page with the expected and the actual pictures, and their differences."""
    counts = result["counts"]
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><title>Viewer kit</title>",
        f"<style>{_STYLE}</style><h1>Viewer kit: {result['verdict']}</h1>",
        f"<p>{counts['passed']} cases passed, {counts['failed']} failed.</p>",
    ]
    for fault in result["faults"]:
        cases = ", ".join(fault["cases"])
        parts.append(
            f"<p class=fault><b>{html.escape(fault['title'])}</b><br>{html.escape(fault['hint'])}"
            f"<br><small>{html.escape(cases)}</small></p>"
        )
    for case in sorted(result["cases"], key=lambda case: case["verdict"] == "passed"):
        name, verdict = html.escape(case["name"]), case["verdict"]
        parts.append(f"<section class={verdict}><h2>{name} <b>{verdict}</b></h2>")
        parts.append(f"<p>{html.escape(case['tests'])}</p>")
        parts += [_frame_html(kit, pictures, frame) for frame in case["frames"]]
        parts.append("</section>")
    return "\n".join(parts) + "</html>\n"


def _frame_html(kit: Path, pictures: Path, frame: dict[str, Any]) -> str:
    expected = read_expected(kit, frame["picture"])
    images = [("expected", expected)]
    if "problem" in frame:
        words = html.escape(frame["problem"])
    else:
        actual = read_picture(pictures, frame["picture"])
        images.append(("actual", actual))
        images.append((f"difference × {_SHOWN_GAIN:g}", _SHOWN_GAIN * np.abs(actual - expected)))
        words = (
            f"largest difference {frame['max']:.4f}, mean {frame['mean']:.5f}, "
            f"pixels beyond the tolerance {100 * frame['share']:.2f} %"
        )
    figures = "".join(
        f'<figure><img alt="{label}" src="data:image/png;base64,'
        f'{base64.b64encode(encode_png(image)).decode()}"><figcaption>{label}</figcaption></figure>'
        for label, image in images
    )
    return f"<div class=frame>{figures}</div><p><small>{frame['picture']}: {words}</small></p>"


def summary_of(result: dict[str, Any]) -> str:
    """Return a viewer's test result as text lines: failed cases, suspected faults, conclusion."""
    lines = []
    for case in result["cases"]:
        for frame in case["frames"]:
            if frame["verdict"] == "failed":
                numbers = f"{100 * frame.get('share', 1):.1f} % of the pixels differ"
                problem = frame.get("problem", f"{frame['picture']}: {numbers}")
                lines.append(f"failed: {case['name']}: {problem}")
                break
    for fault in result["faults"]:
        lines += [f"suspected: {fault['title']}", f"  {fault['hint']}"]
    counts = result["counts"]
    lines.append(f"{result['verdict']}: {counts['passed']} passed, {counts['failed']} failed")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Check the viewer pictures that the command line names, and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pictures", type=Path, help="folder of the viewer's pictures")
    parser.add_argument(
        "--kit", type=Path, default=Path(__file__).parent, help="folder of the viewer kit"
    )
    parser.add_argument(
        "--html", type=Path, help="write an HTML page with all pictures to this file"
    )
    parser.add_argument("--json", type=Path, help="write the result as JSON to this file")
    options = parser.parse_args(arguments)
    try:
        result = check_viewer(options.kit, options.pictures)
        if options.html:
            options.html.write_text(page_of(options.kit, options.pictures, result), "utf-8")
        if options.json:
            options.json.write_text(
                json.dumps(result, indent=2, ensure_ascii=False) + "\n", "utf-8"
            )
    except (KitUnreadable, OSError) as error:
        sys.stderr.write(f"check_viewer: {error}\n")
        return 2
    sys.stdout.write(summary_of(result))
    return 1 if result["verdict"] == "failed" else 0


if __name__ == "__main__":
    sys.exit(main())

"""Compare the pictures of a viewer with those of a viewer test kit; needs only NumPy.

    python check_viewer.py PICTURES [--kit KIT] [--html page.html] [--json result.json]

A picture of frame N of a case is PICTURES/CASE-N.npy or CASE-N.png: what the screen shows over
black, [height, width, 3 or 4]. Floats of four channels are multiplied by alpha; PNGs are not.
Exits 0 if all cases pass, 1 if one fails, 2 if the call is wrong or the page or the result cannot
be written, 4 if the kit or the folder of pictures cannot be read.
"""

import argparse
import base64
import html
import json
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.conformance.viewer_kit.picture_files import PictureUnreadable, encode_png, read_picture

RESULT_SCHEMA = "gsgen-viewer-kit-result/1"
INDEX_SCHEMA = "gsgen-viewer-kit/1"

_DIFFERENCE_GAIN = 4.0  # of differences on the page
_MIN_EXPLAINED_SHARE = 0.8  # share of the failed cases that a suspected fault explains
_NUMBER_TYPES = (int, float)
_FIELD_TYPES: dict[str, dict[str, Any]] = {
    "index": {"tolerance": dict, "faults": list, "cases": list},
    "tolerance": {"pixel": _NUMBER_TYPES, "share": _NUMBER_TYPES, "mean": _NUMBER_TYPES},
    "fault": {"id": str, "title": str, "hint": str, "cases": list},
    "case": {"name": str, "tests": str, "frames": list},
    "frame": {"picture": str},
}


class KitUnreadable(ValueError):
    """Raised if a viewer test kit or the folder of the viewer's pictures cannot be read."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


def check_viewer(kit: Path, pictures: Path) -> dict[str, Any]:
    """Compare a viewer's pictures with the expected pictures of a viewer test kit.

    Returns:
        The result as docs describe it: verdict, cases with their frames, and suspected faults.
    """
    index = _read_compatible_index(kit, pictures)
    if not pictures.is_dir():
        raise KitUnreadable(f"{pictures}: is not a folder, expected that of the viewer's pictures")
    cases = [_check_case(kit, pictures, case, index) for case in index["cases"]]
    failed_case_names = {case["name"] for case in cases if case["verdict"] == "failed"}
    differing_case_names = {
        case["name"] for case in cases if any(map(_does_frame_differ, case["frames"]))
    }
    frames = [frame for case in cases for frame in case["frames"]]
    causes = [frame.get("cause") for frame in frames]
    return {
        "schema": RESULT_SCHEMA,
        "verdict": "failed" if failed_case_names else "passed",
        "counts": {"passed": len(cases) - len(failed_case_names), "failed": len(failed_case_names)},
        "pictures": {
            "total": len(frames),
            "missing": causes.count("missing"),
            "unreadable": causes.count("unreadable"),
        },
        "tolerance": index["tolerance"],
        "tolerance_8_bits": _viewer_tolerance(index, is_png=True),
        "faults": suspected_faults(
            index, differing_case_names, failed_case_names - differing_case_names
        ),
        "cases": cases,
    }


def _read_compatible_index(kit: Path, pictures: Path) -> dict[str, Any]:
    """Read the index of a kit; if it is missing, hint at an index in the folder of pictures."""
    if (kit / "index.json").exists():
        return read_index(kit)
    hint = "`gsgen viewer-kit write FOLDER` writes a kit"
    if (pictures / "index.json").exists():
        hint = f"{pictures} holds an index.json: the two folders may be swapped"
    problem = "holds no index.json" if kit.is_dir() else "is not a folder"
    raise KitUnreadable(f"{kit}: {problem}, expected the folder of a viewer test kit", hint)


def read_index(kit: Path) -> dict[str, Any]:
    """Read the index.json of a viewer test kit, which lists test cases, faults and tolerance."""
    path = kit / "index.json"
    try:
        index = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise KitUnreadable(
            f"{path}: cannot be read as the index of a viewer test kit: {reason}"
        ) from error
    schema = index.get("schema") if isinstance(index, dict) else None
    if schema != INDEX_SCHEMA:
        raise KitUnreadable(f"{path}: the schema is {schema!r}, expected {INDEX_SCHEMA!r}")
    try:
        _require_index(index)
    except KitUnreadable as error:
        hint = "The file is damaged: write the kit again with `gsgen viewer-kit write FOLDER`"
        raise KitUnreadable(f"{path}: {error}", hint) from error
    return dict(index)


def _require_index(index: dict[str, Any]) -> None:
    """Raise if an index lacks a field that the comparison reads."""
    _require_fields("the index", index, "index")
    for name in {"tolerance", "tolerance_8_bits"} & set(index):
        _require_fields(name, index[name], "tolerance")
    for i, fault in enumerate(index["faults"]):
        _require_fields(f"faults[{i}]", fault, "fault")
        if not all(isinstance(name, str) for name in fault["cases"]):
            raise KitUnreadable(f"faults[{i}]: cases is {fault['cases']!r}, expected names")
    for i, case in enumerate(index["cases"]):
        _require_fields(f"cases[{i}]", case, "case")
        for j, frame in enumerate(case["frames"]):
            _require_fields(f"cases[{i}].frames[{j}]", frame, "frame")
        if not case["frames"]:
            raise KitUnreadable(f"cases[{i}]: frames is empty, expected at least one")
    if not index["cases"]:
        raise KitUnreadable("cases is empty, expected at least one")


def _require_fields(where: str, entry: object, kind: str) -> None:
    if not isinstance(entry, dict):
        raise KitUnreadable(f"{where} is a {type(entry).__name__}, expected an object")
    for name, expected in _FIELD_TYPES[kind].items():
        if name not in entry:
            raise KitUnreadable(f"{where}: {name} is missing")
        if not isinstance(entry[name], expected) or isinstance(entry[name], bool):
            words = {dict: "an object", list: "a list", str: "a text"}.get(expected, "a number")
            raise KitUnreadable(f"{where}: {name} is {entry[name]!r}, expected {words}")


def read_expected(kit: Path, name: str) -> np.ndarray:
    """Read an expected picture of a viewer test kit as floats [h, w, 3]."""
    path = kit / "expected" / f"{name}.npy"
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError, SyntaxError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or error
        raise KitUnreadable(f"{path}: the expected picture cannot be read: {reason}") from error


def suspected_faults(
    index: dict[str, Any],
    failed_case_names: set[str],
    unknown: set[str] | frozenset[str] = frozenset(),
) -> list[dict[str, Any]]:
    """Return the known faults that explain the failed cases, or none.

    A fault is ruled out if one of its cases passed, or if most of them are ``unknown``, because
    their pictures cannot be read. Of the others, those are suspected that explain 80 % of the
    failed cases, except subsets of another; if no fault does, the one pair that explains all.
    """
    cases_by_fault: dict[str, frozenset[str]] = {}
    for fault in index["faults"]:
        known_cases = frozenset(fault["cases"]) - unknown
        if (
            known_cases
            and known_cases <= failed_case_names
            and 2 * len(known_cases) >= len(fault["cases"])
        ):
            cases_by_fault[fault["id"]] = known_cases
    largest = {
        fault: cases
        for fault, cases in cases_by_fault.items()
        if not any(cases < other for other in cases_by_fault.values())
    }
    slight = {
        fault["id"]: failed_case_names.intersection(fault.get("slight", []))
        for fault in index["faults"]
    }
    explaining_faults = {
        cases
        for fault, cases in largest.items()
        if len(cases | slight[fault]) >= _MIN_EXPLAINED_SHARE * len(failed_case_names)
    } or _explaining_fault_pair(set(largest.values()), failed_case_names)
    return [fault for fault in index["faults"] if largest.get(fault["id"]) in explaining_faults]


def _explaining_fault_pair(
    cases_by_fault: set[frozenset[str]], failed_case_names: set[str]
) -> set[frozenset[str]]:
    """Return the two sets of cases whose union is ``failed_case_names``, if there is one such pair.

    Sets of one case take no part: any two failures would be explained by two of them.
    """
    larger_case_sets = [cases for cases in cases_by_fault if len(cases) > 1]
    pairs = [
        set(pair)
        for pair in combinations(larger_case_sets, 2)
        if pair[0] | pair[1] == failed_case_names
    ]
    return pairs[0] if len(pairs) == 1 else set()


def _does_frame_differ(frame: dict[str, Any]) -> bool:
    """Return whether a picture was compared and failed, unlike one that cannot be read."""
    return frame["verdict"] == "failed" and "problem" not in frame


def _viewer_tolerance(index: dict[str, Any], *, is_png: bool) -> dict[str, float]:
    limits: dict[str, float] = index["tolerance"]
    return index.get("tolerance_8_bits", limits) if is_png else limits


def _check_case(
    kit: Path, pictures: Path, case: dict[str, Any], index: dict[str, Any]
) -> dict[str, Any]:
    frames = [_check_frame(kit, pictures, frame["picture"], index) for frame in case["frames"]]
    has_case_passed = all(frame["verdict"] == "passed" for frame in frames)
    return {
        "name": case["name"],
        "verdict": "passed" if has_case_passed else "failed",
        "tests": case["tests"],
        "frames": frames,
    }


def _check_frame(kit: Path, pictures: Path, name: str, index: dict[str, Any]) -> dict[str, Any]:
    expected = read_expected(kit, name)
    try:
        actual = read_picture(pictures, name)
        if actual.shape != expected.shape:
            raise PictureUnreadable(
                f"{name}: the picture is {actual.shape[1]}×{actual.shape[0]} pixels, "
                f"expected {expected.shape[1]}×{expected.shape[0]}"
            )
    except PictureUnreadable as error:
        return {"picture": name, "verdict": "failed", "problem": str(error), "cause": error.cause}
    is_png = (pictures / f"{name}.png").is_file()
    return {"picture": name, **compare(expected, actual, _viewer_tolerance(index, is_png=is_png))}


def compare(
    expected: np.ndarray, actual: np.ndarray, tolerance: dict[str, float]
) -> dict[str, Any]:
    """Compare two pictures [h, w, 3]; return the differences, and the limits that they exceed.

    The picture fails if more than ``share`` of its pixels differ by more than ``pixel`` in some
    channel, or if its mean difference is above ``mean``. NaN differs from everything.
    """
    difference = np.nan_to_num(np.abs(actual - expected), nan=1.0, posinf=1.0)
    max_difference = difference.max(axis=2)
    share = float((max_difference > tolerance["pixel"]).mean())
    mean = float(difference.mean())
    exceeded_tolerances = []
    if share > tolerance["share"]:
        percent, max_allowed = 100 * share, 100 * tolerance["share"]
        words = (
            f"{_exceeded_tolerance_text(percent, max_allowed)} % of the pixels differ by more than "
        )
        words += f"{tolerance['pixel']:.3g}, expected at most {max_allowed:g} %"
        exceeded_tolerances.append(_exceeded_entry("share", share, tolerance, words))
    if mean > tolerance["mean"]:
        max_allowed = tolerance["mean"]
        words = f"mean difference {_exceeded_tolerance_text(mean, max_allowed)}, expected at most {max_allowed:g}"
        exceeded_tolerances.append(_exceeded_entry("mean", mean, tolerance, words))
    return {
        "verdict": "failed" if exceeded_tolerances else "passed",
        "max": float(max_difference.max()),
        "mean": mean,
        "share": share,
        "exceeded": exceeded_tolerances,
    }


def _exceeded_entry(
    limit: str, actual: float, tolerance: dict[str, float], message: str
) -> dict[str, Any]:
    return {"limit": limit, "actual": actual, "expected": tolerance[limit], "message": message}


def _exceeded_tolerance_text(actual: float, limit: float) -> str:
    """Return ``actual`` with as many digits as show that it is above ``limit``."""
    texts = (f"{actual:.{digits}g}" for digits in range(3, 18))
    return next((text for text in texts if float(text) > limit), repr(actual))


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
        *(f"<p class=fault>{html.escape(note)}.</p>" for note in _notes(result)),
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
        images.append(
            (f"difference × {_DIFFERENCE_GAIN:g}", _DIFFERENCE_GAIN * np.abs(actual - expected))
        )
        words = (
            f"largest difference {frame['max']:.4f}, mean {frame['mean']:.5f}, "
            f"pixels beyond the tolerance {100 * frame['share']:.2f} %"
        )
        if frame["exceeded"]:
            words = f"{html.escape(_undrawn_reason(frame))} ({words})"
    figures_html = "".join(
        f'<figure><img alt="{label}" src="data:image/png;base64,'
        f'{base64.b64encode(encode_png(image)).decode()}"><figcaption>{label}</figcaption></figure>'
        for label, image in images
    )
    return f"<div class=frame>{figures_html}</div><p><small>{html.escape(frame['picture'])}: {words}</small></p>"


def _undrawn_reason(frame: dict[str, Any]) -> str:
    return "; ".join(entry["message"] for entry in frame["exceeded"])


def _notes(result: dict[str, Any]) -> list[str]:
    """Return what holds for the pictures as a whole: how many are missing, and no known fault."""
    counts = result["pictures"]
    verb_form = "is" if counts["missing"] == 1 else "are"
    words = {"missing": f"{verb_form} missing", "unreadable": "cannot be read"}
    notes = [
        f"{counts[cause]} of {counts['total']} pictures {verb}"
        for cause, verb in words.items()
        if counts[cause]
    ]
    frames = (frame for case in result["cases"] for frame in case["frames"])
    if not result["faults"] and any(map(_does_frame_differ, frames)):
        notes.append("no known fault explains these failures")
    return notes


def summary_of(result: dict[str, Any]) -> str:
    """Return a viewer's test result as text lines: failed cases, suspected faults, conclusion."""
    lines = []
    for case in result["cases"]:
        for frame in case["frames"]:
            if frame["verdict"] == "failed":
                problem = frame.get("problem") or f"{frame['picture']}: {_undrawn_reason(frame)}"
                lines.append(f"failed: {case['name']}: {problem}")
                break
    lines += _notes(result)
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
    except KitUnreadable as error:
        hint = f"\n  hint: {error.hint}" if error.hint else ""
        sys.stderr.write(f"check_viewer: {error}{hint}\n")
        return 4
    sys.stdout.write(summary_of(result))
    try:
        if options.html:
            _write_text(options.html, page_of(options.kit, options.pictures, result))
        if options.json:
            _write_text(options.json, json.dumps(result, indent=2, ensure_ascii=False) + "\n")
    except OSError as error:
        sys.stderr.write(f"check_viewer: {error.filename}: cannot be written: {error.strerror}\n")
        return 2
    return 1 if result["verdict"] == "failed" else 0


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")


if __name__ == "__main__":
    sys.exit(main())

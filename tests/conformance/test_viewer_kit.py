"""The viewer kit without a renderer: its models, its pictures in PNG, and the checking script."""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator
from PIL import Image

from gsgen.conformance.viewer_kit.check_viewer import (
    check_viewer,
    compare,
    page_of,
    suspected_faults,
)
from gsgen.conformance.viewer_kit.document import viewer_kit_schemas
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.picture_files import (
    PictureUnreadable,
    decode_png,
    encode_png,
    read_picture,
)
from gsgen.conformance.viewer_kit.write import TOLERANCE, kit_cases, write_kit
from gsgen.contract import validate
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.checks.viewer_kit import draw_frames
from support.commands import gsgen_here

FIRST = kit_cases()[0].name


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kit(tmp_path_factory.mktemp("kit") / "kit", draw_frames).parent


@pytest.mark.slow
@pytest.mark.parametrize("case", kit_cases(), ids=lambda case: case.name)
def test_a_model_conforms_but_for_the_rules_that_it_breaks_on_purpose(case, kit):
    path = kit / "models" / f"{case.name}.onnx"
    report = validate(path, Settings(level=Level.VALUES))
    errors = {f.rule for f in report.findings if f.severity is Severity.ERROR}
    assert errors == set(case.breaks)


def test_every_fault_has_a_case_and_every_case_a_fault() -> None:
    assert {fault for case in kit_cases() for fault in case.faults} == set(VIEWER_FAULTS)
    names = [case.name for case in kit_cases()]
    assert len(names) == len(set(names))


def test_the_index_and_every_result_follow_their_schemas(kit: Path, tmp_path: Path) -> None:
    index_schema, result_schema = viewer_kit_schemas().values()
    for name, schema in viewer_kit_schemas().items():
        Draft202012Validator.check_schema(schema)
        assert json.loads((kit / name).read_text("utf-8")) == schema
    index = json.loads((kit / "index.json").read_text("utf-8"))
    Draft202012Validator(index_schema).validate(index)
    wrong = np.zeros((48, 64, 3), np.float32)
    np.save(tmp_path / f"{FIRST}-0.npy", wrong)  # all other pictures are missing
    for pictures in (kit / "expected", tmp_path):
        Draft202012Validator(result_schema).validate(check_viewer(kit, pictures))


def test_documents_of_another_shape_break_the_schemas(kit: Path) -> None:
    index_schema, result_schema = map(Draft202012Validator, viewer_kit_schemas().values())
    index = json.loads((kit / "index.json").read_text("utf-8"))
    result = check_viewer(kit, kit / "expected")
    for edit in (
        lambda d: d.pop("tolerance"),
        lambda d: d.update(schema="gsgen-viewer-kit/2"),
        lambda d: d["cases"][0].update(colour="red"),
        lambda d: d["cases"][0]["frames"][0].pop("picture"),
    ):
        for validator, document in ((index_schema, index), (result_schema, result)):
            changed = json.loads(json.dumps(document))
            edit(changed)
            assert not validator.is_valid(changed)
    index["cases"][0]["frames"][0]["values"] = {"pose": [[0.5, "x"]]}
    assert not index_schema.is_valid(index)


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA"])
def test_png_is_read_as_pillow_reads_it(mode: str, tmp_path: Path) -> None:
    random = np.random.default_rng(3)
    smooth = np.cumsum(random.integers(0, 4, (31, 23, len(mode))), axis=1).astype(np.uint8)
    for number, values in enumerate((smooth, random.integers(0, 256, smooth.shape, np.uint8))):
        image = Image.fromarray(values.squeeze(), mode)
        file = io.BytesIO()
        image.save(file, "png", optimize=bool(number))
        np.testing.assert_array_equal(decode_png(file.getvalue()), values)
        image.save(tmp_path / "a.png")
        composited = Image.alpha_composite(
            Image.new("RGBA", image.size, "black"), image.convert("RGBA")
        )
        expected = np.asarray(composited.convert("RGB")) / 255
        assert np.abs(read_picture(tmp_path, "a") - expected).max() <= 1 / 255


def test_png_is_written_as_pillow_reads_it() -> None:
    picture = np.random.default_rng(4).uniform(-0.2, 1.2, (7, 9, 3))
    written = np.asarray(Image.open(io.BytesIO(encode_png(picture))))
    np.testing.assert_array_equal(written, np.rint(np.clip(picture, 0, 1) * 255))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"GIF89a", "not a PNG"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "IHDR"),
        ("a.npy", b"", "cannot be read"),
        ("a.npy", b"\x93NUMPY\x01\x00", "cannot be read"),
    ],
)
def test_a_damaged_picture_is_refused(
    name: str, content: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PictureUnreadable, match=words):
        read_picture(tmp_path, "a")


def test_a_truncated_png_is_refused(tmp_path: Path) -> None:
    whole = encode_png(np.random.default_rng(5).uniform(size=(12, 12, 3)))
    # The last 24 bytes are checksums and the end of the file.
    for length in range(8, len(whole) - 24, 7):
        (tmp_path / "a.png").write_bytes(whole[:length])
        with pytest.raises(PictureUnreadable):
            read_picture(tmp_path, "a")


def test_a_picture_of_bytes_or_of_objects_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(PictureUnreadable, match="uint8"):
        read_picture(tmp_path, "a")
    np.save(tmp_path / "a.npy", np.array([[[{}]]]), allow_pickle=True)
    with pytest.raises(PictureUnreadable, match="cannot be read"):
        read_picture(tmp_path, "a")


def test_the_three_parts_of_the_tolerance() -> None:
    right = np.full((20, 20, 3), 0.5)
    one_pixel, two_pixels, overall = right.copy(), right.copy(), right + 0.0011
    one_pixel[0, 0, 1] += 0.5
    two_pixels[0, :3, 1] += 0.5
    tolerance = TOLERANCE
    assert compare(right, right, tolerance)["verdict"] == "passed"
    assert compare(right, one_pixel, tolerance)["verdict"] == "passed"
    assert compare(right, two_pixels, tolerance)["share"] > tolerance["share"]
    assert compare(right, two_pixels, tolerance)["verdict"] == "failed"
    assert compare(right, overall, tolerance)["share"] == 0
    assert compare(right, overall, tolerance)["verdict"] == "failed"
    assert compare(right, right * np.nan, tolerance)["verdict"] == "failed"


def test_the_largest_fault_that_fails_whole_is_suspected() -> None:
    cases = {"a": ["1", "2"], "b": ["1"], "c": ["2", "3"], "d": ["2", "1"]}
    index = {"faults": [{"id": name, "cases": names} for name, names in cases.items()]}
    assert [fault["id"] for fault in suspected_faults(index, {"1", "2"})] == ["a", "d"]
    assert [fault["id"] for fault in suspected_faults(index, {"1"})] == ["b"]
    assert suspected_faults(index, set()) == []


def test_the_script_needs_numpy_alone(kit: Path, tmp_path: Path) -> None:
    for path in (kit / "expected").glob("*.npy"):
        Image.fromarray(np.rint(np.load(path) * 255).astype(np.uint8)).save(
            tmp_path / f"{path.stem}.png"
        )
    code = (
        "import sys, runpy\n"
        "sys.argv = sys.argv[1:]\n"
        "try: runpy.run_path(sys.argv[0], run_name='__main__')\n"
        "except SystemExit as end: code = end.code\n"
        "loaded = {name.partition('.')[0] for name in sys.modules}\n"
        "assert not loaded & {'gsgen', 'onnx', 'onnxruntime', 'PIL', 'typer'}, loaded\n"
        "sys.exit(code)\n"
    )
    options = [str(tmp_path), "--json", str(tmp_path / "result.json")]
    command = [sys.executable, "-c", code, str(kit / "check_viewer.py"), *options]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stdout + completed.stderr
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert result["counts"] == {"passed": len(kit_cases()), "failed": 0}


def test_the_command_names_a_missing_picture_and_writes_a_page(kit: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for path in (kit / "expected").glob("*.npy"):
        (pictures / path.name).write_bytes(path.read_bytes())
    (pictures / f"{FIRST}-0.npy").unlink()
    completed = gsgen_here(
        "viewer-kit", "check", str(kit), str(pictures), "--html", "p.html", cwd=tmp_path
    )
    assert completed.code == 1
    assert f"failed: {FIRST}: {FIRST}-0: the picture is missing" in completed.out
    page = (tmp_path / "p.html").read_text("utf-8")
    assert "http" not in page
    result = check_viewer(kit, pictures)
    assert page == page_of(kit, pictures, result)
    pictures_shown = 3 * sum(len(case["frames"]) for case in result["cases"]) - 2
    assert page.count("<img ") == pictures_shown


def test_a_folder_that_is_no_kit_or_is_full_is_refused(tmp_path: Path) -> None:
    completed = gsgen_here("viewer-kit", "check", str(tmp_path), str(tmp_path), cwd=tmp_path)
    assert completed.code == 4
    assert "index.json" in completed.err
    (tmp_path / "file").touch()
    with pytest.raises(ConfigInvalid, match="the output folder is not empty"):
        write_kit(tmp_path, draw_frames)


def test_a_missing_folder_of_pictures_is_one_error(kit: Path, tmp_path: Path) -> None:
    completed = gsgen_here("viewer-kit", "check", str(kit), "picturs", cwd=tmp_path)
    assert completed.code == 4
    assert "picturs: is not a folder, expected that of the viewer's pictures" in completed.err
    assert "the picture is missing" not in completed.out

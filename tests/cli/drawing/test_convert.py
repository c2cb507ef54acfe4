"""`gsgen convert`, as a user gets it."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import open_splats, write_ply
from support.commands import gsgen, gsgen_here
from support.splat_files import scene


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("convert") / "scene.ply"
    write_ply(file, scene(50, 2))
    return file


def test_lossy_conversion_reports_its_losses(source, tmp_path):
    target = tmp_path / "scene.spz"
    completed = gsgen("convert", source, target, "--sh-degree", "1")
    assert (completed.code, completed.err) == (0, "")
    lines = completed.out.splitlines()
    assert lines[0].startswith(f"{target}: 50 splats of SH degree 1, spz, 0.01 MiB → 0.00 MiB")
    assert lines[1] == "lost: harmonics above degree 1"
    assert [line.split()[0] for line in lines[3:]] == [
        *("position", "rotation", "scale", "opacity", "color", "harmonics")
    ]
    assert open_splats(target).degree == 1


def test_lossless_conversion_is_reported_as_exact(source, tmp_path):
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--encoding", "ascii")
    assert completed.code == 0
    assert completed.out.splitlines()[1:] == ["nothing was lost"]


def test_conversion_report_is_valid_json(source, tmp_path):
    target = tmp_path / "new" / "folder" / "a"
    completed = gsgen_here("convert", source, target, "--format", "splat", "--json")
    assert completed.code == 0, completed.err
    assert target.is_file()
    document = json.loads(completed.out)
    assert document["degree"] == [2, 0]
    assert document["lost"] == ["harmonics above degree 0"]
    assert {entry["name"] for entry in document["differences"]} >= {"position", "opacity"}


def test_a_frame_of_a_generator_becomes_splats(tmp_path):
    rows = np.zeros((2, 10), np.float32)
    rows[:, [3, 4, 7, 9]] = 0.5
    np.savez(tmp_path / "a.npz", gaussians=rows, appearance=np.ones((2, 3), np.float32))
    assert gsgen_here("convert", tmp_path / "a.npz", tmp_path / "a.ply").code == 0
    assert len(open_splats(tmp_path / "a.ply")) == 2


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (
            ("a.ksplat",),
            2,
            "a.ksplat: KSPLAT can only be read, expected a format that can be written: .ply, ",
        ),
        (("a",), 2, "a: has the suffix (none), expected a format"),
        (("a", "--format", "splt"), 2, "--format: unknown format 'splt'\n  Did you mean 'splat'?"),
        (
            ("a.ply", "--spz-version", "4"),
            2,
            "--spz-version: applies to spz files, but the output format is ply\n",
        ),
        (
            ("a.spz", "--encoding", "ascii"),
            2,
            "--encoding: applies to ply files, but the output format is spz\n",
        ),
        (
            ("/dev/null/no/a.ply",),
            2,
            "/dev/null/no/a.ply: the file cannot be written: Not a directory\n",
        ),
    ],
)
def test_impossible_conversion_exits_with_a_code(source, tmp_path, words, code, message):
    completed = gsgen_here("convert", source, *words, cwd=tmp_path)
    assert completed.code == code
    assert completed.err.startswith(f"gsgen: {message}")
    assert not list(tmp_path.iterdir())


def test_a_source_that_cannot_be_read_exits_4(tmp_path):
    broken_ply = tmp_path / "bad.ply"
    broken_ply.write_bytes(b"ply\nnonsense\nend_header\n")
    completed = gsgen_here("convert", broken_ply, tmp_path / "a.spz")
    assert completed.code == 4
    assert completed.err.startswith(
        f"gsgen: {broken_ply}: header line 2: 'nonsense'\n  expected format, "
    )


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """Fifty splats, two of which a training run has spoiled."""
    file = tmp_path / "trained.ply"
    write_ply(file, scene(50, 0))
    raw = bytearray(file.read_bytes())
    body, row = len(raw) - 50 * 14 * 4, 14 * 4
    raw[body + 7 * row : body + 7 * row + 4] = np.float32(np.nan).tobytes()
    raw[body + 30 * row + 8 : body + 30 * row + 12] = np.float32(np.inf).tobytes()
    file.write_bytes(raw)
    return file


TEXT = "2 of 50 rows cannot be drawn and are left out; row 7 is the first, where x is nan"


def test_rows_that_cannot_be_drawn_are_left_out_where_asked(trained: Path) -> None:
    target = trained.with_name("kept.ply")
    completed = gsgen_here("convert", trained, target)
    assert completed.code == 4
    assert "property x: 1 of 50 rows are invalid: row 7 is nan" in completed.err
    assert "--drop-invalid" in completed.err
    assert not target.exists()
    completed = gsgen_here("convert", trained, target, "--drop-invalid")
    assert completed.code == 0, completed.err
    assert completed.err == f"note: {trained}: {TEXT}\n"
    assert completed.out.splitlines()[0].startswith(f"{target}: 48 splats")
    completed = gsgen_here("convert", trained, target, "--drop-invalid", "--json")
    assert json.loads(completed.out)["notes"] == [f"{trained}: {TEXT}"]
    assert len(open_splats(target)) == 48
    assert gsgen_here("convert", target, trained.with_name("again.spz")).err == ""


@pytest.mark.parametrize("command", ["render", "export"])
def test_a_few_rows_do_not_keep_a_scene_from_being_used(trained: Path, command: str) -> None:
    words = {
        "render": ("render", trained, "-o", trained.with_name("a.png"), "--width", "64"),
        "export": ("export", "static", trained, "-o", trained.with_name("a.onnx")),
    }[command]
    completed = gsgen_here(*words)
    assert completed.code == 0, completed.err
    assert f"note: {trained}: {TEXT}" in completed.err
    assert "48" in (completed.out if command == "render" else completed.err)


@pytest.mark.parametrize("path_kind", ["itself", "another spelling", "a symlink", "a hard link"])
def test_source_is_not_overwritten_without_force(
    source: Path, tmp_path: Path, path_kind: str
) -> None:
    file = tmp_path / "a.ply"
    file.write_bytes(source.read_bytes())
    target = file if path_kind == "itself" else tmp_path / "b.ply"
    if path_kind == "another spelling":
        target = tmp_path / ".." / tmp_path.name / "a.ply"
    elif path_kind == "a symlink":
        target.symlink_to(file)
    elif path_kind == "a hard link":
        target.hardlink_to(file)
    completed = gsgen_here("convert", file, target, "--sh-degree", "0")
    assert completed.code == 2
    assert f"gsgen: {target}: is also an input file, which would be overwritten" in completed.err
    assert "--force" in completed.err
    assert file.read_bytes() == source.read_bytes()
    assert gsgen_here("convert", file, target, "--sh-degree", "0", "--force").code == 0
    assert open_splats(target).degree == 0


def test_edits_are_applied_in_the_order_typed(source: Path, tmp_path: Path) -> None:
    position = open_splats(source).position
    target = tmp_path / "a.ply"
    words = ("convert", source, target, "--translate", "1,0,0", "--scale", "2")
    assert gsgen_here(*words, "--translate=0,0,-3").code == 0
    expected = (position + np.float32([1, 0, 0])) * 2 + np.float32([0, 0, -3])
    np.testing.assert_allclose(open_splats(target).position, expected, atol=1e-5)
    words = ("convert", source, target, "--scale", "2", "--translate", "1,0,0")
    assert gsgen_here(*words).code == 0
    np.testing.assert_allclose(
        open_splats(target).position, position * 2 + np.float32([1, 0, 0]), atol=1e-5
    )


def test_several_sources_are_merged(source: Path, tmp_path: Path) -> None:
    write_ply(tmp_path / "other.ply", scene(30, 0, seed=1))
    completed = gsgen_here("convert", source, tmp_path / "other.ply", tmp_path / "all.ply")
    assert completed.code == 0, completed.err
    merged = open_splats(tmp_path / "all.ply")
    assert (len(merged), merged.degree) == (80, 2)
    np.testing.assert_array_equal(merged.position[:50], open_splats(source).position)
    assert not merged.sh[50:, 1:].any()
    write_ply(tmp_path / "mip.ply", scene(3, 0, antialiased=True))
    completed = gsgen_here("convert", source, tmp_path / "mip.ply", tmp_path / "no.ply")
    assert completed.code == 1
    assert "antialiased: the value differs between the sources: False and True" in completed.err


def test_statistics_are_printed_and_drawn(source: Path, tmp_path: Path) -> None:
    words = ("convert", source, tmp_path / "a.ply", "--where", "x>0", "--statistics")
    completed = gsgen_here(*words, "--histograms", tmp_path / "a.png", "--json")
    assert completed.code == 0, completed.err
    (summary,) = json.loads(completed.out)["statistics"]
    assert summary[0]["name"] == "x"
    assert summary[0]["low"] > 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert "deviation" in gsgen_here(*words).out


def test_invalid_edits_are_refused(source: Path, tmp_path: Path) -> None:
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--translate", "1,2")
    assert completed.code == 2
    assert completed.err.startswith("gsgen: --translate: is '1,2', expected finite numbers X,Y,Z")
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--where", "opacity>2")
    assert completed.code == 1
    assert "--where opacity>2 leaves none of 50 splats" in completed.err
    assert not (tmp_path / "a.ply").exists()


def test_axes_of_spz_are_those_of_the_option(source: Path, tmp_path: Path) -> None:
    words = ("convert", source, tmp_path / "a.spz", "--spz-axes", "RDF")
    completed = gsgen_here(*words)
    assert completed.code == 0, completed.err
    position = open_splats(source).position
    turned = open_splats(tmp_path / "a.spz").position * np.float32([1, -1, -1])
    np.testing.assert_allclose(turned, position, atol=2e-4)
    assert (
        gsgen_here("convert", tmp_path / "a.spz", tmp_path / "b.ply", "--spz-axes", "RDF").code == 0
    )
    np.testing.assert_allclose(open_splats(tmp_path / "b.ply").position, position, atol=2e-4)


def test_half_of_the_splats_are_left(source: Path, tmp_path: Path) -> None:
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--decimate", "50%")
    assert completed.code == 0, completed.err
    assert 15 <= len(open_splats(tmp_path / "a.ply")) <= 25
    assert "nothing was lost by the format" in completed.out
    left = len(open_splats(tmp_path / "a.ply"))
    merge_message = (
        f"--decimate merged {len(open_splats(source))} splats into {left}: detail is lost"
    )
    assert completed.out.rstrip().endswith(merge_message)
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--decimate", "50%", "--json")
    assert json.loads(completed.out)["notes"] == [merge_message]


def test_a_fraction_of_the_splats_is_a_percentage(source: Path, tmp_path: Path) -> None:
    completed = gsgen_here("convert", source, tmp_path / "a.ply", "--decimate", "0.1")
    assert completed.code == 2
    assert "expected a number of splats, or a percentage such as 25%" in completed.err
    completed = gsgen_here("convert", tmp_path / "sourse.ply", tmp_path / "a.ply")
    assert completed.err.startswith("gsgen: ")
    assert "\n" not in completed.err.strip().replace("\n  ", "")


@pytest.mark.parametrize(("words", "missing"), [(["garden.ply"], "target"), ([], "SOURCE…")])
def test_the_argument_that_was_left_out_is_named(tmp_path, words, missing):
    completed = gsgen_here("convert", *words, cwd=tmp_path)
    assert completed.code == 2
    assert f"Missing argument '{missing}'" in completed.err


MESH = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


@pytest.mark.parametrize(
    ("name", "text"), [("mesh.ply", MESH), ("wall.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")]
)
@pytest.mark.parametrize(
    ("before", "after"), [(("convert",), ("out.spz",)), (("export", "html"), ("-o", "page.html"))]
)
def test_mesh_is_refused_as_a_mesh(
    tmp_path: Path, name: str, text: str, before: tuple[str, ...], after: tuple[str, ...]
) -> None:
    (tmp_path / name).write_text(text, "utf-8")
    completed = gsgen_here(*before, name, *after, cwd=tmp_path)
    assert completed.code == 4
    assert f"gsgen: {name}: is a mesh, expected splats" in completed.err
    hint = {
        "convert": f"`gsgen render {name} -o picture.png` draws it",
        "export": "of a scene file",
    }
    assert hint[before[0]] in completed.err
    assert completed.err.count("\n") == 2

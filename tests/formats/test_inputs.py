"""The splat file that a path names: in a folder, an archive, a gzip file or standard input."""

import gzip
import io
import mmap
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    ArchiveDamaged,
    FileUnreadable,
    FormatWarning,
    NotSupported,
    SizeExceeded,
    open_splats,
    write_ply,
    write_sog,
    write_spz,
)
from gsgen.formats import inputs as inputs_module
from gsgen.formats.inputs import resolve_input, training_folder
from support.foreign_files import LFS
from support.splat_files import FIELDS, samples, scene

SPLATS = scene(40, 1)


def is_same(path: Path | str) -> bool:
    """Whether a path opens as ``SPLATS``."""
    opened = open_splats(path)
    return all(np.array_equal(getattr(opened, name), getattr(SPLATS, name)) for name in FIELDS)


def ply(folder: Path) -> bytes:
    """``SPLATS`` as the bytes of a PLY file."""
    write_ply(folder / "source.ply", SPLATS)
    return (folder / "source.ply").read_bytes()


def archive(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """A ZIP archive of members."""
    with zipfile.ZipFile(path, "w", method) as stream:
        for name, content in members.items():
            stream.writestr(name, content)
    return path


@pytest.mark.parametrize(
    "extra",
    [
        {},
        {"readme.txt": b"hello", "thumbnail.jpg": b"\xff\xd8\xff"},
        {"__MACOSX/._gs_scene.ply": b"ply\n", ".DS_Store": b"x"},
        {"cameras.json": b'[{"img_name": "a", "rotation": []}]'},
        {"empty.ply": b""},
    ],
)
@pytest.mark.parametrize("name", ["gs_scene.ply", "folder/scene.ply", "a/b/without suffix"])
def test_a_zip_of_one_splat_file_is_read(
    tmp_path: Path, extra: dict[str, bytes], name: str
) -> None:
    content = ply(tmp_path)
    assert is_same(archive(tmp_path / "a.zip", {name: content, **extra}))
    assert is_same(archive(tmp_path / "b.ply", {name: content, **extra}, zipfile.ZIP_STORED))


@pytest.mark.parametrize(
    "name", ["ply", "spz", "splat", "ksplat", "glb", "sog", "npz", "checkpoint"]
)
def test_every_format_is_read_from_a_zip_and_a_gzip_file(tmp_path: Path, name: str) -> None:
    suffixes = {"checkpoint": "pt"}
    for content in samples(tmp_path)[name]:
        file = tmp_path / f"a.{suffixes.get(name, name)}"
        file.write_bytes(content)
        expected = len(open_splats(file))
        packed = tmp_path / f"{file.name}.gz"
        packed.write_bytes(gzip.compress(content))
        assert len(open_splats(packed)) == expected
        assert len(open_splats(archive(tmp_path / "a.zip", {file.name: content}))) == expected


def test_a_gzip_file_in_a_zip_is_read(tmp_path: Path) -> None:
    assert is_same(archive(tmp_path / "a.zip", {"a.ply.gz": gzip.compress(ply(tmp_path))}))


def test_a_zip_of_several_splat_files_lists_them(tmp_path: Path) -> None:
    content = ply(tmp_path)
    file = archive(tmp_path / "a.zip", {"a.ply": content, "b.ply": content})
    with pytest.raises(NotSupported, match=r"2 files of splats: a.ply, b.ply"):
        open_splats(file)


def test_a_zip_of_a_pointer_has_no_splats(tmp_path: Path) -> None:
    with pytest.raises(NotSupported, match=r"a ZIP archive of a.txt"):
        open_splats(archive(tmp_path / "a.zip", {"a.txt": LFS}))


def test_an_encrypted_zip_is_refused(tmp_path: Path) -> None:
    file = archive(tmp_path / "a.zip", {"a.ply": ply(tmp_path)})
    content = bytearray(file.read_bytes())
    content[6] |= 1  # the flag of the member, and of its entry in the list
    content[content.index(b"PK\x01\x02") + 8] |= 1
    file.write_bytes(content)
    with pytest.raises(ArchiveDamaged, match="password"):
        open_splats(file)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    content = ply(tmp_path) + bytes(1 << 20)
    packed = tmp_path / "a.ply.gz"
    packed.write_bytes(gzip.compress(content))
    for file in (packed, archive(tmp_path / "a.zip", {"a.ply": content})):
        with pytest.raises(SizeExceeded):
            resolve_input(file, max_bytes=1000)


@pytest.mark.parametrize("cut", [20, 200, -1])
def test_a_cut_gzip_file_is_damaged(tmp_path: Path, cut: int) -> None:
    packed = tmp_path / "a.ply.gz"
    packed.write_bytes(gzip.compress(ply(tmp_path))[:cut])
    with pytest.raises(ArchiveDamaged):
        open_splats(packed)


def training(folder: Path, *iterations: int) -> Path:
    """The folder of a 3DGS training, whose newest iteration is ``SPLATS``."""
    newest = max(iterations)
    for number in iterations:
        cloud = folder / f"point_cloud/iteration_{number}/point_cloud.ply"
        cloud.parent.mkdir(parents=True)
        write_ply(cloud, SPLATS if number == newest else scene(3, 0))
    (folder / "cfg_args").write_text("Namespace(sh_degree=3, white_background=False)")
    (folder / "cameras.json").write_text("[]")
    write_ply(folder / "input.ply", scene(5, 0))
    return folder


@pytest.mark.parametrize("numbers", [(7000,), (7000, 30000), (9000, 10000, 30), (1, 2, 10)])
def test_a_training_folder_is_its_newest_iteration(
    tmp_path: Path, numbers: tuple[int, ...]
) -> None:
    folder = training(tmp_path / "run", *numbers)
    assert is_same(folder)
    assert is_same(folder / "point_cloud")
    assert is_same(folder / f"point_cloud/iteration_{max(numbers)}")
    run = training_folder(folder)
    assert run is not None
    assert (run.iteration, run.cameras) == (max(numbers), folder / "cameras.json")
    packed = {
        file.relative_to(tmp_path).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }
    assert is_same(archive(tmp_path / "run.zip", packed))


@pytest.mark.parametrize(
    ("text", "antialiased"),
    [("Namespace(antialiasing=True)", True), ("Namespace(antialiasing=False)", False), ("", False)],
)
def test_the_options_of_a_training_say_whether_it_was_antialiased(
    tmp_path: Path, text: str, antialiased: bool
) -> None:
    folder = training(tmp_path / "run", 5)
    (folder / "cfg_args").write_text(text)
    assert open_splats(folder).antialiased == antialiased


def test_other_layouts_of_folders_are_opened(tmp_path: Path) -> None:
    for name, write in (
        ("one/scene.ply", write_ply),
        ("gsplat/ply/point_cloud_30.ply", write_ply),
        ("spz/only.spz", write_spz),
    ):
        (tmp_path / name).parent.mkdir(parents=True)
        write(tmp_path / name, SPLATS)
        assert len(open_splats(tmp_path / name.split("/")[0])) == len(SPLATS)
    (tmp_path / "sog").mkdir()
    write_sog(tmp_path / "sog" / "meta.json", SPLATS)
    assert len(open_splats(tmp_path / "sog")) == len(SPLATS)


def test_a_folder_of_several_files_or_of_none_is_refused(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        write_ply(tmp_path / name, SPLATS)
    with pytest.raises(NotSupported, match=r"the folder holds 2 files of splats: a.ply, b.ply"):
        open_splats(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileUnreadable, match="the path is a folder without a file of splats"):
        open_splats(tmp_path / "empty")


@pytest.mark.parametrize("name", ["ply", "spz", "splat", "glb", "sog"])
def test_standard_input_is_read_once_for_all_readers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    content = samples(tmp_path)[name][0]
    inputs_module._standard_input.cache_clear()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    file = tmp_path / f"a.{name}"
    file.write_bytes(content)
    assert len(open_splats("-")) == len(open_splats(file)) == len(open_splats("-"))
    inputs_module._standard_input.cache_clear()


def test_content_in_memory_is_named_like_its_archive(tmp_path: Path) -> None:
    file = resolve_input(archive(tmp_path / "a.zip", {"b/c.ply": ply(tmp_path)}))
    assert str(file) == f"{tmp_path}/a.zip/b/c.ply"
    assert isinstance(file.data, mmap.mmap)


def test_files_of_other_methods_beside_the_splats_are_named(tmp_path: Path) -> None:
    folder = training(tmp_path / "run", 7)
    (folder / "point_cloud/iteration_7/deformation.pth").write_bytes(b"x")
    (folder / "deform/iteration_7").mkdir(parents=True)
    with pytest.warns(FormatWarning, match="not used: file deform/, file deformation.pth"):
        open_splats(folder)

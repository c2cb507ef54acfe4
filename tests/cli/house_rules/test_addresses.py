"""Every command that opens a file takes its address; texts name the address, not the copy."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from typer.main import get_command

from gsgen.cli.command_group import build
from gsgen.cli.fetched_inputs import OUTPUT_PARAMETERS
from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import open_splats, write_ply
from support.commands import gsgen, gsgen_here
from support.models.small_models import good_rows, save_moving
from support.splat_files import scene, zipped
from support.web.file_server import FileServer, Served, file_server

Words = list[str | Path]
CAMERAS = {
    "fl_x": 100,
    "w": 64,
    "h": 48,
    "frames": [
        {"file_path": "a", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}
    ],
}  # fmt: skip
# Command → its words for the address of splats, of a model, of cameras, and a folder for outputs.
COMMANDS: dict[str, Callable[[str, str, str, Path], Words]] = {
    "render": lambda splats, model, cameras, out: [
        "render", splats, "-o", out / "a.png", "--size", "64x48",
    ],
    "render a model": lambda splats, model, cameras, out: [
        "render", model, "-o", out / "a.png", "--size", "64x48", "--trust",
    ],
    "render with cameras": lambda splats, model, cameras, out: [
        "render", splats, "--camera", f"{cameras}#0", "-o", out / "a.png",
    ],
    "convert": lambda splats, model, cameras, out: ["convert", splats, splats, out / "a.spz"],
    "validate": lambda splats, model, cameras, out: ["validate", model, "-o", out / "a.txt"],
    "inspect": lambda splats, model, cameras, out: ["inspect", model],
    "diff": lambda splats, model, cameras, out: ["diff", model, model],
    "card": lambda splats, model, cameras, out: ["card", model, "-o", out / "a.md"],
    "export static": lambda splats, model, cameras, out: [
        "export", "static", splats, "-o", out / "a.onnx", "--level", "static", "--verify", "quick",
    ],
    "export html": lambda splats, model, cameras, out: [
        "export", "html", splats, "-o", out / "a.html",
    ],
    "bake": lambda splats, model, cameras, out: ["bake", model, "-o", out / "a.ply"],
    "rewrite": lambda splats, model, cameras, out: ["rewrite", model, "--dry-run"],
    "vectors": lambda splats, model, cameras, out: ["vectors", model, "--into", out / "v"],
    "tiles build": lambda splats, model, cameras, out: [
        "tiles", "build", splats, "-o", out / "t", "--engine", "serial",
    ],
}  # fmt: skip


@pytest.fixture
def server(tmp_path: Path) -> Iterator[FileServer]:
    write_ply(tmp_path / "a.ply", scene(40, 1))
    files: dict[str, bytes | Served] = {
        "/d/a.ply": (tmp_path / "a.ply").read_bytes(),
        "/d/a.onnx": save_moving(tmp_path / "a.onnx", good_rows(20)).read_bytes(),
        "/d/transforms.json": json.dumps(CAMERAS).encode(),
        "/d/page.ply": b"<!doctype html><html><title>Sign in</title></html>",
        "/d/secret.ply": Served(status=401),
        "/d/huge.ply": Served(b"ply", headers={"Content-Length": str(1 << 50)}),
    }
    with file_server(files) as server:
        yield server


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_takes_addresses(command: str, server: FileServer, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    names = ("a.ply?key=//1", "a.onnx", "transforms.json")
    words = COMMANDS[command](*(server.address_of(f"/d/{name}") for name in names), out)
    completed = gsgen_here(*words)
    written = "".join(
        file.read_text("utf-8", "replace") for file in out.rglob("*") if file.is_file()
    )
    assert completed.code == 0, completed.err
    for text in (completed.out, completed.err, written):
        assert ".part" not in text, text
        assert "key=" not in text, text
    asked = {word for word in map(str, words) if word.startswith(server.origin)}
    assert set(server.paths) == {
        word.removeprefix(server.origin).partition("#")[0] for word in asked
    }
    assert len(server.paths) == len(set(server.paths))


def test_copies_are_removed_when_the_command_ends(server: FileServer, tmp_path: Path) -> None:
    folder = tmp_path / "temporary"
    folder.mkdir()
    for name in ("a.onnx", "page.ply", "missing.onnx"):
        completed = gsgen("inspect", server.address_of(f"/d/{name}"), env={"TMPDIR": str(folder)})
        assert completed.code == (0 if name == "a.onnx" else 4)
    assert list(folder.iterdir()) == []


def opening_commands() -> Iterator[tuple[str, Any]]:
    def walk(command: Any, name: str) -> Iterator[tuple[str, Any]]:
        context = click.Context(command, info_name=name)
        for subcommand in command.list_commands(context) if hasattr(command, "commands") else ():
            yield from walk(command.get_command(context, subcommand), f"{name} {subcommand}")
        if not hasattr(command, "commands"):
            yield name.strip(), command

    yield from walk(get_command(build()), "")


def test_outputs_are_told_from_inputs() -> None:
    """A new option of a path is listed here, and among the outputs if it is one."""
    inputs = {
        parameter.name
        for _, command in opening_commands()
        for parameter in command.params
        if hasattr(parameter.type, "resolve_path")
    } - OUTPUT_PARAMETERS
    assert inputs == {
        "baseline", "body", "cameras", "checkpoint", "config", "difix", "embeddings", "file",
        "captions", "first", "flame", "flame_ids", "frames", "kit", "manifest", "model", "models", "motion",
        "network", "neural", "ort", "path", "paths", "post", "scene", "scenes", "second", "sound", "source", "style",
        "three", "transform", "vae", "xfails",
    }  # fmt: skip


def test_a_number_of_a_range_is_finite() -> None:
    """Click lets NaN through every range, and infinity through those without a maximum."""
    options = [
        (command.callback, parameter.name, parameter.opts[0], value)
        for _, command in opening_commands()
        for parameter in command.params
        if "float" in parameter.type.name and _has_range(parameter)
        for value in (math.nan, math.inf)
    ]
    assert len(options) > 20
    for callback, name, option, value in options:
        with pytest.raises(ConfigInvalid, match=rf"^{option}: is (nan|inf), expected a finite"):
            callback(**{name: value})


def _has_range(parameter: Any) -> bool:
    places = (parameter, parameter.type)
    return any(getattr(place, end, None) is not None for place in places for end in ("min", "max"))


@pytest.mark.parametrize("address", ["https://a.example/b.spz", "s3://a/b.spz", "hf://a/b/c.spz"])
def test_an_output_is_no_address(address: str, server: FileServer, tmp_path: Path) -> None:
    file = tmp_path / "a.ply"
    for words in (["convert", file, address], ["render", file, "-o", address]):
        completed = gsgen_here(*words, cwd=tmp_path)
        assert completed.code == 2
        assert "is an address, expected a path on this machine" in completed.err
    assert not (tmp_path / "https:").exists()


@pytest.mark.parametrize(
    ("name", "message", "hint"),
    [
        ("missing.ply", "the server answers 404", "Check the address"),
        ("secret.ply", "the server answers 401", "not public"),
        ("page.ply", "a web page (HTML) titled 'Sign in'", "Download the file itself"),
        ("huge.ply", "expected 17,179,869,184 bytes or fewer", ""),
    ],
)
@pytest.mark.parametrize("command", ["render", "convert", "validate", "export static"])
def test_a_wrong_address_is_one_error(
    command: str, name: str, message: str, hint: str, server: FileServer, tmp_path: Path
) -> None:
    address = server.address_of(f"/d/{name}")
    words = {"validate": ["validate", address]}.get(
        command, COMMANDS.get(command, COMMANDS["convert"])(address, "", "", tmp_path)
    )
    completed = gsgen_here(*words)
    errors = [line for line in completed.err.splitlines() if not line.startswith(" ")]
    assert completed.code in (2, 4)
    assert len(errors) == 1
    assert errors[0].startswith(f"gsgen: {address}: ")
    assert message in errors[0]
    assert hint in completed.err


def test_a_server_that_hangs_ends_at_the_deadline(tmp_path: Path) -> None:
    from support.web.hostile_server import ANSWERS, hostile_server

    with hostile_server(ANSWERS["body-drips"]) as server:
        completed = gsgen_here(
            "render", server.address_of("a.ply"), "-o", tmp_path / "a.png",
            env={"GSGEN_FETCH_SECONDS": "0.5"},
        )  # fmt: skip
    assert completed.code == 4
    assert "did not come within 0.5 s" in completed.err
    assert "GSGEN_FETCH_SECONDS sets the seconds" in completed.err


def test_a_tileset_is_streamed_from_its_address(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(3000, 0))
    folder = tmp_path / "t"
    assert gsgen_here("tiles", "build", tmp_path / "a.ply", "-o", folder).code == 0
    files = {
        f"/t/{f.relative_to(folder)}": f.read_bytes() for f in folder.rglob("*") if f.is_file()
    }
    files |= {"/t/index.json": files["/t/tileset.json"], "/t/index": files["/t/tileset.json"]}
    with file_server(files) as server:
        for name in ("tileset.json", "", "index.json?key=//1", "index"):
            completed = gsgen_here(
                "render", server.address_of(f"/t/{name}"), "-o", tmp_path / "a.png",
                "--size", "64x48",
            ) if name else gsgen_here("tiles", "info", server.address_of("/t/"))  # fmt: skip
            assert completed.code == 0, completed.err
        contents = [path for path in server.paths if path.endswith(".glb")]
        assert contents
        assert not [path for path in contents if "?" in path]
        assert "/t/index.json?key=%2F%2F1" in server.paths


def test_a_command_for_models_names_a_tileset(server: FileServer) -> None:
    server.files["/tileset.json"] = b'{"asset": {"version": "1.1"}, "root": {}}'
    completed = gsgen_here("inspect", server.address_of("/tileset.json"))
    assert completed.code == 4
    assert "is not an ONNX model but a tileset of 3D Tiles" in completed.err


def test_the_hub_is_an_address(server: FileServer, tmp_path: Path) -> None:
    server.files["/datasets/o/n/resolve/main/a.ply"] = server.files["/d/a.ply"]
    completed = gsgen_here(
        "convert", "hf://datasets/o/n/a.ply", tmp_path / "b.ply", env={"HF_ENDPOINT": server.origin}
    )
    assert completed.code == 0, completed.err
    assert len(open_splats(tmp_path / "b.ply")) == 40


def test_an_archive_of_one_model_or_mesh_is_opened(server: FileServer, tmp_path: Path) -> None:
    mesh = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    archives = {"mesh.zip": {"a.obj": mesh}, "model.zip": {"m/a.onnx": server.files["/d/a.onnx"]}}
    for name, members in archives.items():
        (tmp_path / name).write_bytes(zipped(members))
        server.files[f"/{name}"] = (tmp_path / name).read_bytes()
        for path in (tmp_path / name, server.address_of(f"/{name}")):
            completed = gsgen_here("render", path, "-o", tmp_path / "a.png", "--size", "64x48")
            assert completed.code == 0, completed.err
    for path in (tmp_path / "model.zip", server.address_of("/model.zip")):
        completed = gsgen_here("validate", path)
        assert completed.code == 0, completed.err
        assert f"{path}/m/a.onnx" in completed.out
        completed = gsgen_here("inspect", path)
        assert completed.out.startswith(f"{path}/m/a.onnx: ")


def test_vectors_of_an_address_need_a_folder(server: FileServer) -> None:
    completed = gsgen_here("vectors", server.address_of("/d/a.onnx"))
    assert completed.code == 2
    assert "--into: is needed for a model at an address" in completed.err

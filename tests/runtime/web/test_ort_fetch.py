"""Libraries of pages are fetched as the pinned packages, or not at all."""

import hashlib
import io
import json
import posixpath
import re
import tarfile
from dataclasses import replace
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.formats import write_ply
from gsgen.reference_plugins.synthetic import torus_knot
from gsgen.runtime.web import npm_files
from gsgen.runtime.web.onnxruntime_web import ORT
from gsgen.runtime.web.three_js import THREE
from support.commands import gsgen_here
from support.web.packages import package as npm_package


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The archive that a program in npm's place writes into its working folder."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        names = [f"package/dist/{name}" for name in ORT.names]
        for name in [*names, *(f"package/{name}" for name in THREE.names)]:
            entry = tarfile.TarInfo(name)
            entry.size = len(name)
            archive.addfile(entry, io.BytesIO(name.encode()))
    (tmp_path / "saved.tgz").write_bytes(stream.getvalue())
    npm = tmp_path / "npm"
    npm.write_text(f'#!/bin/sh\ncp "{tmp_path}/saved.tgz" package.tgz\n', "utf-8")
    npm.chmod(0o755)
    monkeypatch.setattr(npm_files, "which", lambda _: str(npm))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return stream.getvalue()


@pytest.mark.parametrize("library", [ORT, THREE])
def test_the_pinned_package_is_unpacked_once(
    package: bytes, monkeypatch: pytest.MonkeyPatch, library: npm_files.NpmFiles
) -> None:
    library = replace(library, sha256=hashlib.sha256(package).hexdigest())
    folder = library.located(None)
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {path.relative_to(folder).as_posix() for path in files} == set(library.names)
    assert all(path.read_text().endswith(path.name) for path in files)
    monkeypatch.setattr(npm_files, "which", lambda _: None)
    assert library.located(None) == folder
    assert library.located(folder) == folder
    (folder / library.names[-1]).unlink()
    with pytest.raises(InputUnreadable, match=f"lacks {library.names[-1]}"):
        library.located(folder)


@pytest.mark.parametrize("library", [ORT, THREE])
def test_another_package_is_refused(package: bytes, library: npm_files.NpmFiles) -> None:
    with pytest.raises(ConfigInvalid, match=hashlib.sha256(package).hexdigest()):
        library.located(None)
    assert not library.cached().exists()


def test_without_npm_the_package_to_fetch_is_named(
    package: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(npm_files, "which", lambda _: None)
    with pytest.raises(ConfigInvalid, match="npm is not installed"):
        ORT.located(None)


def test_three_brings_all_modules_that_its_modules_import() -> None:
    folder = npm_package(f"{THREE.package}-{THREE.version}")
    imported = re.compile(
        r"^(?:import|export|\})[^;'\"]*?from\s*['\"](\.[^'\"]+)['\"]", re.MULTILINE
    )
    for name in THREE.names:
        for target in imported.findall((folder / name).read_text("utf-8")):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), target))
            assert path in THREE.names, f"{name} imports {path}"


def test_a_page_of_splats_needs_no_onnx_runtime(
    package: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(npm_files, "which", lambda _: None)
    write_ply(tmp_path / "knot.ply", torus_knot(20))
    page = gsgen_here("export", "html", tmp_path / "knot.ply", "-o", tmp_path / "page.html")
    assert page.code == 0, page.err
    model = find("drift").write(tmp_path)
    page = gsgen_here("export", "html", model, "-o", tmp_path / "model.html")
    assert page.code == 2
    assert "npm is not installed" in page.err


def test_a_scene_with_meshes_needs_three(
    package: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(npm_files, "which", lambda _: None)
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps({"meshes": ["a.obj"]}), "utf-8")
    page = gsgen_here("export", "html", scene, "-o", tmp_path / "page.html")
    assert page.code == 2
    assert "npm is not installed, which fetches three.js" in page.err
    assert "--three DIR" in page.err

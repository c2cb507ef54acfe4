"""ONNX Runtime Web is fetched as the pinned package, or not at all."""

import hashlib
import io
import tarfile
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.formats import write_ply
from gsgen.reference_plugins.synthetic import torus_knot
from gsgen.runtime.web import onnxruntime_web
from support.commands import gsgen_here


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    """The archive that a program in npm's place writes into its working folder."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        for name in onnxruntime_web.ORT_FILES:
            entry = tarfile.TarInfo(f"package/dist/{name}")
            entry.size = len(name)
            archive.addfile(entry, io.BytesIO(name.encode()))
    (tmp_path / "saved.tgz").write_bytes(stream.getvalue())
    npm = tmp_path / "npm"
    npm.write_text(f'#!/bin/sh\ncp "{tmp_path}/saved.tgz" package.tgz\n', "utf-8")
    npm.chmod(0o755)
    monkeypatch.setattr(onnxruntime_web, "which", lambda _: str(npm))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return stream.getvalue()


def test_the_pinned_package_is_unpacked_once(
    package: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnxruntime_web, "_PACKAGE_SHA256", hashlib.sha256(package).hexdigest())
    folder = onnxruntime_web.ort_folder(None)
    assert {path.name: path.read_text() for path in folder.iterdir()} == {
        name: name for name in onnxruntime_web.ORT_FILES
    }
    monkeypatch.setattr(onnxruntime_web, "which", lambda _: None)
    assert onnxruntime_web.ort_folder(None) == folder


def test_another_package_is_refused(package: bytes) -> None:
    with pytest.raises(ConfigInvalid, match=hashlib.sha256(package).hexdigest()):
        onnxruntime_web.ort_folder(None)
    assert not onnxruntime_web.cached_ort().exists()


def test_without_npm_the_package_to_fetch_is_named(
    package: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnxruntime_web, "which", lambda _: None)
    with pytest.raises(ConfigInvalid, match="npm is not installed"):
        onnxruntime_web.ort_folder(None)


def test_a_page_of_splats_needs_no_onnx_runtime(
    package: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnxruntime_web, "which", lambda _: None)
    write_ply(tmp_path / "knot.ply", torus_knot(20))
    page = gsgen_here("export", "html", tmp_path / "knot.ply", "-o", tmp_path / "page.html")
    assert page.code == 0, page.err
    model = find("drift").write(tmp_path)
    page = gsgen_here("export", "html", model, "-o", tmp_path / "model.html")
    assert page.code == 2
    assert "npm is not installed" in page.err

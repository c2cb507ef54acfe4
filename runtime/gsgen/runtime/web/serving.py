"""A local web server of an HTML page with models, which delivers that page's files only."""

__all__ = ["ModelServer"]

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, final
from urllib.parse import quote, unquote, urlsplit

from gsgen.contract.errors import GsgenError
from gsgen.formats import open_splats
from gsgen.runtime.sources.scene_file import is_scene_file
from gsgen.runtime.web.local_server import LocalHandler, LocalServer
from gsgen.runtime.web.onnxruntime_web import ORT_FILES
from gsgen.runtime.web.pages import (
    ModelView,
    PageFile,
    SplatReader,
    client_file,
    client_names,
    files_shown,
    scene_bytes,
    served_page,
)
from gsgen.runtime.web.three_js import THREE

_MIME_TYPES: Final = {
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".json": "application/json",
    ".wasm": "application/wasm",
}

ContentTypeAndBytes = tuple[str, bytes]
"""A content type and the bytes of a file."""


@final
class ModelServer(LocalServer):
    """Serves an HTML page of models on this machine.

    Args:
        models: Files of the models, and scene files.
        view: How they are shown.
        ort: Folder of ONNX Runtime Web; None without generators.
        three: Folder of three.js; None without meshes.
        port: Port; 0 takes one that is free.
        read: Reads files of splats.
        images: Pictures that generators are computed from.
        image_cameras: Their cameras, as :func:`gsgen.runtime.playback.picture_inputs.camera_list` writes them.
    """

    def __init__(
        self,
        models: Sequence[Path],
        view: ModelView,
        *,
        ort: Path | None,
        three: Path | None = None,
        port: int = 0,
        read: SplatReader = open_splats,
        images: Sequence[Path] = (),
        image_cameras: str = "",
    ) -> None:
        super().__init__("127.0.0.1", port, _Handler)
        self._models = {f"/models/{number}/{path.name}": path for number, path in enumerate(models)}
        addresses = {quote(address): path for address, path in self._models.items()}
        pictures = {f"/pictures/{number}/{path.name}": path for number, path in enumerate(images)}
        cameras = "/pictures/cameras.json" if image_cameras else ""
        view = replace(view, images=tuple(map(quote, pictures)), image_cameras=cameras)
        three_address = None if three is None else "/gsgen/three/"
        page = served_page(addresses, view, three_address).encode()
        self._content_readers: dict[str, Callable[[], ContentTypeAndBytes]] = {
            "/": lambda: ("text/html; charset=utf-8", page),
            "/versions": lambda: ("application/json", json.dumps(self._versions()).encode()),
        }
        for name in client_names():
            self._content_readers[f"/gsgen/{name}"] = partial(_client_content, name)
        libraries = {"ort": (ort, ORT_FILES), "three": (three, THREE.names)}
        for library, (folder, names) in libraries.items():
            for name in names if folder else ():
                address = f"/gsgen/{library}/{name}"
                self._content_readers[address] = partial(_file, (folder or Path()) / name)
        if image_cameras:
            cameras_file = ("application/json", image_cameras.encode())
            self._content_readers[cameras] = lambda: cameras_file
        for address, path in pictures.items():
            self._content_readers[address] = partial(_file, path)
        for address, path in self._models.items():
            if not is_scene_file(path):
                self._content_readers[address] = partial(_model_content, PageFile(path), read)
                continue
            parts = {
                f"{address}/{number}/{part.path.name}": part
                for number, part in enumerate(files_shown([path]))
            }
            for part_address, part in parts.items():
                self._content_readers[part_address] = partial(_model_content, part, read)
            self._content_readers[address] = partial(_scene_content, path, parts)

    def content(self, path: str) -> ContentTypeAndBytes | None:
        """Return content type and bytes of the file at a URL path; None if no file is there."""
        make = self._content_readers.get(path)
        return None if make is None else make()

    def _versions(self) -> dict[str, str]:
        """Return a revision of each model's file, a text that changes when the file changes."""
        versions = {}
        for address, path in self._models.items():
            if path.exists():
                parts = files_shown([path]) if is_scene_file(path) else []
                files = [path, *(part.path for part in parts)]
                versions[quote(address)] = "-".join(map(_version, files))
        return versions


def _version(path: Path) -> str:
    """Return a text that changes when a file changes."""
    if not path.exists():
        return "0"
    status = path.stat()
    return f"{status.st_mtime_ns}-{status.st_size}"


def _scene_content(path: Path, parts: Mapping[str, PageFile]) -> ContentTypeAndBytes:
    """Return a scene file; the addresses of its models change when their files change."""
    addresses = [f"{quote(address)}?{_version(part.path)}" for address, part in parts.items()]
    return "application/json", scene_bytes(path, addresses)


def _client_content(name: str) -> ContentTypeAndBytes:
    return _MIME_TYPES[Path(name).suffix], client_file(name)


def _file(path: Path) -> ContentTypeAndBytes:
    return _MIME_TYPES.get(path.suffix, "application/octet-stream"), path.read_bytes()


def _model_content(file: PageFile, read: SplatReader) -> ContentTypeAndBytes:
    return "application/octet-stream", file.content(read)


@final
class _Handler(LocalHandler):
    server: ModelServer

    def answer(self, *, with_body: bool) -> None:
        """Answer a request with a file of the web page, or with the status 404."""
        try:
            content = self.server.content(unquote(urlsplit(self.path).path))
        except GsgenError as error:
            kind, body = "text/plain; charset=utf-8", str(error).encode(errors="replace")
            self._send_response(500, kind, body, with_body=with_body)
            return
        if content is None:
            self._send_response(404, "text/plain", b"not found", with_body=with_body)
        else:
            self._send_response(200, *content, with_body=with_body)

    def _send_response(self, status: int, kind: str, body: bytes, *, with_body: bool) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-cache")
        self.end_headers()
        if with_body:
            self.wfile.write(body)

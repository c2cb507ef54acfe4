"""ONNX Runtime Web, which runs models in a web page: fetched once, by exact version and digest."""

__all__ = ["ORT_FILES", "ORT_VERSION", "cached_ort", "ort_folder"]

import hashlib
import subprocess
import tarfile
from pathlib import Path
from shutil import which
from typing import Final

from platformdirs import user_cache_path

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.drafts import temporary_folder

ORT_VERSION: Final = "1.30.0"
"""The version that pages load; the client is tested with this one."""

_NPM_PACKAGE: Final = "onnxruntime-web"
_PACKAGE_SHA256: Final = "d2228df7e4616bc3348bf504ee888f3bec43789a273f0a63f3e68d203ce3bf71"
_BUILD_FILES: Final = {
    "ort.jspi.bundle.min.mjs": "ort-wasm-simd-threaded.jspi.wasm",
    "ort.webgpu.bundle.min.mjs": "ort-wasm-simd-threaded.asyncify.wasm",
}
ORT_FILES: Final = (*_BUILD_FILES, *_BUILD_FILES.values())
"""Two builds, each a module and its WebAssembly: for browsers that suspend WebAssembly, and others."""


def cached_ort() -> Path:
    """Return the cache folder of the user for the downloaded files of ONNX Runtime Web."""
    return user_cache_path("gsgen", appauthor=False) / f"{_NPM_PACKAGE}-{ORT_VERSION}"


def ort_folder(user_folder: Path | None) -> Path:
    """Return a folder with the files of ONNX Runtime Web, fetching them into the cache if needed.

    Args:
        user_folder: A folder of the user, such as ``dist`` of the npm package.

    Raises:
        InputUnreadable: ``user_folder`` lacks a file.
        ConfigInvalid: The files cannot be fetched, or are others than those of the pinned version.
    """
    if user_folder is not None:
        missing = [name for name in ORT_FILES if not (user_folder / name).is_file()]
        if missing:
            hint = f"Name the folder `dist` of the npm package {_NPM_PACKAGE}@{ORT_VERSION}."
            raise InputUnreadable(
                f"the folder lacks {', '.join(missing)}", where=str(user_folder), hint=hint
            )
        return user_folder
    folder = cached_ort()
    if not all((folder / name).is_file() for name in ORT_FILES):
        _fetch_package(folder)
    return folder


def _fetch_package(folder: Path) -> None:
    """Fetch the npm package, check its digest, and put the needed files into ``folder``."""
    package = f"{_NPM_PACKAGE}@{ORT_VERSION}"
    hint = f"Fetch {package} yourself, and name its folder `dist`: --ort DIR"
    npm = which("npm")
    if npm is None:
        message = "npm is not installed, which fetches ONNX Runtime Web"
        raise ConfigInvalid(message, where=package, hint=hint)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(folder.parent) as work_folder:
        result = subprocess.run(
            [npm, "pack", "--silent", package],
            cwd=work_folder,
            capture_output=True,
            text=True,
            encoding="utf-8",
        )
        archives = list(work_folder.glob("*.tgz"))
        if result.returncode or not archives:
            lines = result.stderr.strip().splitlines() or ["npm pack failed"]
            raise ConfigInvalid(lines[-1], where=package, hint=hint)
        content = archives[0].read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        if digest != _PACKAGE_SHA256:
            message = f"has the digest {digest}, expected {_PACKAGE_SHA256}"
            raise ConfigInvalid(message, where=package, hint=hint)
        with tarfile.open(archives[0]) as archive:
            for name in ORT_FILES:
                file = archive.extractfile(f"package/dist/{name}")
                assert file is not None, f"{name} is a file in the package of this digest"
                (work_folder / name).write_bytes(file.read())
        folder.mkdir(exist_ok=True)
        for name in ORT_FILES:
            (work_folder / name).replace(folder / name)

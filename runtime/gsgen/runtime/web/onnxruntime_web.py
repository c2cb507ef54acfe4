"""ONNX Runtime Web, which runs models in a web page."""

__all__ = ["ORT", "ORT_FILES", "ORT_VERSION", "cached_ort", "ort_folder"]

from pathlib import Path
from typing import Final

from gsgen.runtime.web.npm_files import NpmFiles

ORT_VERSION: Final = "1.30.0"
"""The version that pages load; the client is tested with this one."""

_BUILD_FILES: Final = {
    "ort.jspi.bundle.min.mjs": "ort-wasm-simd-threaded.jspi.wasm",
    "ort.webgpu.bundle.min.mjs": "ort-wasm-simd-threaded.asyncify.wasm",
}
ORT_FILES: Final = (*_BUILD_FILES, *_BUILD_FILES.values())
"""Two builds, each a module and its WebAssembly: for browsers that suspend WebAssembly, and others."""

ORT: Final = NpmFiles(
    title="ONNX Runtime Web",
    package="onnxruntime-web",
    version=ORT_VERSION,
    sha256="d2228df7e4616bc3348bf504ee888f3bec43789a273f0a63f3e68d203ce3bf71",
    folder="dist",
    names=ORT_FILES,
    option="--ort",
)
"""The files that pages load."""


def cached_ort() -> Path:
    """Return the cache folder of the user for the downloaded files of ONNX Runtime Web."""
    return ORT.cached()


def ort_folder(user_folder: Path | None) -> Path:
    """Return a folder with the files of ONNX Runtime Web, fetching them into the cache if needed.

    Args:
        user_folder: A folder of the user, such as ``dist`` of the npm package.

    Raises:
        InputUnreadable: ``user_folder`` lacks a file.
        ConfigInvalid: The files cannot be fetched, or are others than those of the pinned version.
    """
    return ORT.located(user_folder)

"""The one gate to files that a model names: external weights, pictures, test vectors.

Such a file is a regular file, of one name, in or below the model's folder. If the model itself is
a link, as in caches that store files by digest, the file may also be a link to one that lies right
beside the model's real file.
"""

__all__ = [
    "FileRefused",
    "find_contained_file",
    "loaded_files",
    "require_loadable",
    "weight_faults",
]

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath
from urllib.parse import unquote

from onnx import TensorProto

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.model.graph import stored_bytes
from gsgen.contract.model.model_file import ExternalRef, ModelFile, open_model, parse_length

_FILE_BESIDE_MODEL = "a file beside the model"
_MISSING = "no such file"
_LFS_POINTER = b"version https://git-lfs"
# ONNX Runtime takes this name for an address in its memory; Windows allows no such name.
_REFUSED_LOCATION_CHARACTER = "*"


class FileRefused(ModelUnreadable):
    """Raised if a file that a model names must not be read, or cannot be.

    Attributes:
        actual: The fault.
        expected: The file that the contract asks for.
    """

    def __init__(self, model: Path, location: str, fault: tuple[str, str]) -> None:
        self.actual, self.expected = fault
        super().__init__(
            f"names the file {location!r:.200}: {self.actual}, expected {self.expected}",
            where=str(model),
            hint="`gsgen explain GS001` says why.",
        )


def find_contained_file(model: Path, location: str) -> Path:
    """Return the real path of a file that a model names by ``location``.

    The path counts from the folder of the model or, if the model is a link and no such file is
    there, from the folder of its real file.

    Raises:
        FileRefused: It is missing, lies elsewhere, is not a regular file, or has several names.
    """
    lookup_outcome = _look_up_file(model, location)
    if isinstance(lookup_outcome, Path):
        return lookup_outcome
    raise FileRefused(model, location, lookup_outcome)


def _look_up_file(model: Path, location: str) -> Path | tuple[str, str]:
    """Return the real path of a file that a model names, or its fault and the expected file."""
    if not location or "\0" in location or _REFUSED_LOCATION_CHARACTER in location:
        return "no file name", _FILE_BESIDE_MODEL
    if _does_leave_folder(location):
        return "leads out of the model's folder", "a relative path below it"
    named_path = model.parent.resolve() / model.name
    resolved_path = named_path.resolve()
    base = named_path if os.path.lexists(named_path.parent / location) else resolved_path
    try:
        path = (base.parent / location).resolve()
        is_below = path.is_relative_to(base.parent)
        is_beside_real_model = base != resolved_path and path.parent == resolved_path.parent
        if not (is_below or is_beside_real_model):
            return f"is a link to {path}", "a file below the model's folder"
        status = path.stat()  # tells why, where Path.is_file of Python 3.14 is False
    except (FileNotFoundError, NotADirectoryError):
        return _MISSING, _FILE_BESIDE_MODEL
    except (OSError, RuntimeError) as error:  # the name is too long, or links form a cycle
        reason = error.strerror if isinstance(error, OSError) else "links form a cycle"
        return f"cannot be looked up: {reason}", _FILE_BESIDE_MODEL
    if not stat.S_ISREG(status.st_mode):
        return "is a folder, a pipe or a device", "a regular file beside the model"
    if status.st_nlink > 1:  # it may be another program's file, under a second name
        return f"is a file of {status.st_nlink} names (hard links)", "a copy of it"
    return path


def _does_leave_folder(location: str) -> bool:
    windows_path = PureWindowsPath(location)
    return bool(
        PurePosixPath(location).is_absolute() or windows_path.anchor or ".." in windows_path.parts
    )


def loaded_files(file: ModelFile) -> list[Path]:
    """Return the real paths of the files that a runtime reads to load a model.

    These are the model and its external weights, without those that must not be read.
    """
    locations = dict.fromkeys(ref.location for ref in file.external)
    lookup_results = [_look_up_file(file.loading_path, location) for location in locations]
    return [
        file.loading_path.resolve(),
        *(path for path in lookup_results if isinstance(path, Path)),
    ]


def weight_faults(file: ModelFile) -> dict[str, tuple[str, str]]:
    """Return the faults of external weights by location: the actual state, and the expected one.

    Of these files the first bytes alone are read.
    """
    faults: dict[str, tuple[str, str]] = {}
    for ref, tensor in zip(file.external, file.external_tensors, strict=True):
        fault = _weight_fault(file.loading_path, ref, tensor)
        if fault is not None:
            faults.setdefault(ref.location, fault)
    return faults


def _weight_fault(model: Path, ref: ExternalRef, tensor: TensorProto) -> tuple[str, str] | None:
    lookup_result = _look_up_file(model, ref.location)
    if not isinstance(lookup_result, Path):
        actual, expected = lookup_result
        if actual == _MISSING:
            actual += _near_name(model, ref.location)
        weight = f" (weight {ref.tensor!r})" if ref.location else ""
        return f"{actual}{weight}", expected
    try:
        with lookup_result.open("rb") as file:
            if file.read(len(_LFS_POINTER)) == _LFS_POINTER:
                actual = "is a git LFS pointer, not the file: fetch it with `git lfs pull`"
                return actual, "the weights"
    except OSError as error:
        return f"cannot be read: {error.strerror}", _FILE_BESIDE_MODEL
    size = lookup_result.stat().st_size
    for entry in tensor.external_data:
        if entry.key in ("offset", "length") and parse_length(entry.value) is None:
            actual = f"declares the {entry.key} {entry.value!r:.40} for weight {ref.tensor!r}"
            return actual, "a whole number"
    payload = stored_bytes(tensor)
    needed_bytes = ref.offset + (payload if ref.length is None else ref.length)
    if needed_bytes > size:
        return f"has {size} bytes (weight {ref.tensor!r})", f"at least {needed_bytes}"
    if payload and ref.length not in (None, payload):
        return f"declares a length of {ref.length} bytes for weight {ref.tensor!r}", f"{payload}"
    return None


def _near_name(model: Path, location: str) -> str:
    """Return a file beside a model that has another spelling than a missing one; or empty."""
    spellings = {
        "the location is percent-encoded": unquote(location),
        "the location has backslashes": location.replace("\\", "/"),
    }
    for reason, spelling in spellings.items():
        if spelling != location and isinstance(_look_up_file(model, spelling), Path):
            return f"; {reason}, and {spelling!r} is there"
    folder = (model.parent / location).parent
    names = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    name = PurePosixPath(location).name
    for other_name in names:
        if other_name.casefold() == name.casefold():
            return f"; {other_name!r} is there, which differs in case"
    return ""


def require_loadable(path: Path) -> Path:
    """Return the path under which a program may load a model together with its external weights.

    Every command calls this before a library that reads external weights gets the path.

    Raises:
        ModelUnreadable: ``path`` is not an ONNX model.
        FileRefused: External weights are outside the model's folder, missing or too short.
    """
    file = open_model(path)
    for location, fault in weight_faults(file).items():
        raise FileRefused(path, location, fault)
    loading_path = file.loading_path
    if file.external and not _is_utf8(str(loading_path)):
        message = "has external weights and a path that is not UTF-8, which no runtime opens"
        raise ModelUnreadable(message, where=str(path), hint="Rename the file or its folder.")
    return loading_path


def _is_utf8(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True

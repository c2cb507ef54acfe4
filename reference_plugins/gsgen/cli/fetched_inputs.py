"""Fetches the files that a command reads, which may be addresses, or ZIP archives of one model or mesh.

A command gets the paths of temporary copies, which texts name by the addresses.
"""

__all__ = ["OUTPUT_PARAMETERS", "fetch_inputs", "is_copy"]

import functools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid

OUTPUT_PARAMETERS: Final = frozenset(
    [
        "dump", "folder", "histograms", "html", "into", "log", "output", "pages", "pictures",
        "plot", "report", "target",
    ]
)  # fmt: skip
"""Parameters that name what a command writes, or a folder that it serves."""

# Texts that hold the path of a file: SOURCE, FILE#CAMERA, [NAME=]FILE.
_TEXT_PARAMETERS: Final = ("camera", "inputs", "pose", "sources", "tileset")
# Parameters of models; splats are read from standard input by gsgen.formats.
_MODEL_PARAMETERS: Final = ("first", "model", "models", "paths", "scenes", "second")
_TILESET_PARAMETERS: Final = ("paths", "scene", "scenes", "sources", "tileset")
_STREAM_PARAMETERS: Final = ("scenes", "tileset")  # of a streamed SOG, too
_ADDRESS_TEXT: Final = re.compile(
    r"(?P<before>[\w.]*=)?(?P<address>[A-Za-z][A-Za-z0-9+.-]+:/.*?)(?P<after>#[^#/]*)?"
)
_MEGABYTE: Final = 1 << 20


def fetch_inputs(
    values: dict[str, Any], path_parameters: set[str], text_outputs: set[str]
) -> dict[str, Any]:
    """Return the arguments of a command with paths of copies in place of addresses and archives.

    Args:
        values: Parameter → its value.
        path_parameters: Parameters that are paths.
        text_outputs: Parameters of outputs for which ``-`` is standard output.

    Raises:
        InputUnreadable: A file cannot be had; the subclass says why.
        ConfigInvalid: An output is an address, or a standard output that takes no such file.
    """
    for name in path_parameters & OUTPUT_PARAMETERS - text_outputs:
        if str(values.get(name)) == "-":
            raise ConfigInvalid(
                "standard output takes text, expected the path of a file",
                where="-",
                hint="Name a file.",
            )
    return {
        name: _map_texts(value, functools.partial(_local_text, name))
        if name in path_parameters or name in _TEXT_PARAMETERS
        else value
        for name, value in values.items()
    }


def _map_texts(value: Any, convert: Callable[[str], str]) -> Any:
    if isinstance(value, list | tuple):
        return type(value)(_map_texts(item, convert) for item in value)
    return convert(os.fspath(value)) if isinstance(value, str | os.PathLike) and value else value


def _local_text(parameter: str, text: str) -> str:
    """Return a parameter's text with the path of a copy of an address, a member or a pipe."""
    if text == "-":
        return str(_copy_of_standard_input()) if parameter in _MODEL_PARAMETERS else text
    match = _ADDRESS_TEXT.fullmatch(text)
    if match is None:
        from gsgen.contract.model.fetched_inputs import ARCHIVE_SUFFIX

        is_packed = ARCHIVE_SUFFIX in text.lower() and parameter not in OUTPUT_PARAMETERS
        return _unpacked(text) if is_packed else text
    from gsgen.contract.inputs.addresses import address_of

    has_name = parameter in _TEXT_PARAMETERS
    address = address_of(match["address"] if has_name else text)
    if not address:
        return text
    if parameter in OUTPUT_PARAMETERS:
        raise ConfigInvalid("is an address, expected a path on this machine", where=text)
    if parameter in _TILESET_PARAMETERS:
        from gsgen.formats.tileset_paths import names_stream, names_tileset

        if (names_stream if parameter in _STREAM_PARAMETERS else names_tileset)(address):
            return _without_slashes_in_query(address)
    path = str(_fetched(address))
    return f"{match['before'] or ''}{path}{match['after'] or ''}" if has_name else path


_copies: Final[dict[str, Path]] = {}
"""Address → its copy, which the end of a command removes."""


_copy_folders: Final[list[Path]] = []


def _fetched(address: str) -> Path:
    path = _copies.get(address)
    if path is None or not path.exists():
        path = _copies[address] = _new_copy(address)
    return path


def _new_copy(address: str) -> Path:
    from gsgen.cli.progress import clear
    from gsgen.cli.text_streams import show_path_as
    from gsgen.contract.inputs.addresses import folder_of
    from gsgen.contract.model.fetched_inputs import local_file

    try:
        path = local_file(address, on_bytes=_show_progress)
    finally:
        clear()
    plain_address, has_query, _ = address.partition("?")
    show_path_as(str(path), plain_address + ("?…" if has_query else ""))
    show_path_as(f"{path.parent}{os.sep}", folder_of(address))
    _copy_folders.append(path.parent)
    return Path(_unpacked(str(path)))


def _unpacked(text: str) -> str:
    from gsgen.cli.text_streams import show_path_as, with_shown_names
    from gsgen.contract.model.fetched_inputs import archive_of, local_file

    content = local_file(text)
    if content == Path(text):
        return text
    # The name within the archive follows; the copy of an archive is shown by its address.
    folder = next(parent for parent in content.parents if parent.name.endswith(".part"))
    show_path_as(f"{folder}{os.sep}", with_shown_names(f"{archive_of(text) or text}{os.sep}"))
    _copy_folders.append(folder)
    return str(content)


@functools.cache
def _copy_of_standard_input() -> Path:
    """Copy standard input into a file, which has the suffix of models if it is one."""
    import shutil
    import sys

    from gsgen.cli.text_streams import show_path_as
    from gsgen.contract.file_kinds.recognition import kind_of_file
    from gsgen.contract.inputs.local_copies import kept_folder
    from gsgen.contract.process.atomic_files import MODEL_SUFFIX

    path = kept_folder() / "stdin"
    with path.open("xb") as file:
        shutil.copyfileobj(sys.stdin.buffer, file)
    kind = kind_of_file(path)
    if kind is not None and kind.name == "onnx":
        path = path.rename(path.with_suffix(MODEL_SUFFIX))
    show_path_as(str(path), "standard input")
    _copy_folders.append(path.parent)
    return path


def is_copy(path: Path) -> bool:
    """Return whether a path is that of a temporary copy, beside which nothing can be kept."""
    return any(path.is_relative_to(folder) for folder in _copy_folders)


def _show_progress(address: str, received: int, total: int | None) -> None:
    from gsgen.cli.progress import progress

    name = address.partition("?")[0].rpartition("/")[2]
    megabytes, whole = received // _MEGABYTE, -(-(total or 0) // _MEGABYTE)
    count = f"{megabytes} of {whole} MB" if total else f"{megabytes} MB"
    progress(f"fetching {name}: {count}")


def _without_slashes_in_query(address: str) -> str:
    """Encode slashes in the query of an address, of which ``Path`` would merge two into one."""
    plain_address, mark, query = address.partition("?")
    return plain_address + mark + query.replace("/", "%2F")

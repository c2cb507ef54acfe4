"""The next thing to type where a command lacks the option -o, or cannot write such a file."""

__all__ = ["command_that_writes", "output_hint", "require_own_output"]

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid

# Command → suffix of its usual output, and the suffixes of outputs typed without -o.
_OUTPUT_SUFFIXES: Final = {
    "render": (".png", (".png", ".jpg", ".jpeg", ".webp", ".exr", ".gif", ".mp4")),
    "bake": (".ply", (".ply",)),
}


def output_hint(command: str, words: Sequence[str], values: Mapping[str, Any]) -> str:
    """Return the command line with an option -o, for errors; empty if the command is not known.

    Args:
        command: The name of the command, such as ``render``.
        words: The words that follow it on the command line.
        values: The values of its options and arguments.
    """
    files = [str(value) for value in _flatten_values(values) if str(value) in words]
    if command not in _OUTPUT_SUFFIXES or not files:
        return ""
    suffix, output_suffixes = _OUTPUT_SUFFIXES[command]
    remaining_words = list(words)
    if any(Path(file).exists() for file in files):  # words such as "interpolate" name none
        strays = [file for file in files if file.isalpha() and not Path(file).exists()]
        files = [file for file in files if file not in strays]
        remaining_words = [word for word in words if word not in strays]
    last_file = files[-1]
    is_output = len(files) > 1 and Path(last_file).suffix.lower() in output_suffixes
    if is_output and not Path(last_file).exists():
        remaining_words.remove(last_file)
        return _output_hint(command, remaining_words, last_file)
    return _output_hint(command, remaining_words, f"{Path(files[0]).stem or command}{suffix}")


def _flatten_values(values: Mapping[str, Any]) -> list[Any]:
    """Return the arguments of a command line: the values of SCENES or MODEL."""
    entries = values.get("scenes") or values.get("model") or ()
    return [entries] if isinstance(entries, str) else list(entries)


def _output_hint(command: str, words: Sequence[str], output: str) -> str:
    return f"Type `{shlex.join(['gsgen', command, *words, '-o', output])}`."


def command_that_writes(output: Path, sources: Sequence[str | Path]) -> str:
    """Return the call of the command that writes a file of this suffix; empty if none does.

    Args:
        output: The path that the user named.
        sources: What it is made of.
    """
    from gsgen.contract.process.atomic_files import MODEL_SUFFIX, PAGE_SUFFIXES
    from gsgen.formats.codecs import codec_of_suffix
    from gsgen.formats.tileset_paths import names_tileset

    suffix, first = output.suffix.lower(), Path(sources[0]).suffix.lower() if sources else ""
    codec = codec_of_suffix(output)
    if suffix in _OUTPUT_SUFFIXES["render"][1]:
        words = ["render", *sources, "-o", output]
    elif suffix in PAGE_SUFFIXES:
        words = ["export", "html", *sources, "-o", output]
    elif suffix == MODEL_SUFFIX and first != MODEL_SUFFIX:
        words = ["export", "static", *sources, "-o", output]
    elif codec is not None and codec.write:
        name = "bake" if first == MODEL_SUFFIX else "convert"
        words = [name, *sources, "-o", output]
    elif names_tileset(output):
        words = ["tiles", "build", *sources, "-o", output.parent / "tiles"]
    else:
        return ""
    return shlex.join(["gsgen", *map(str, words)])


def require_own_output(command: str, output: Path, sources: Sequence[str | Path]) -> None:
    """Raise if another command writes files of the output's suffix, and name its call.

    Raises:
        ConfigInvalid: Another command does.
    """
    from gsgen.contract.file_kinds.recognition import kind_of_file
    from gsgen.contract.process.atomic_files import MODEL_SUFFIX

    call, first = command_that_writes(output, sources), str(sources[0]) if sources else ""
    if Path(first).is_file():
        kind, is_model = kind_of_file(Path(first)), first.lower().endswith(MODEL_SUFFIX)
        is_read = not is_model if kind is None else kind.name == "onnx" or kind.holds_splats
        if not is_read:
            return  # its reader says what the file is
    if call and call.split()[1] != command:
        raise ConfigInvalid(
            f"is not made of {first} by `gsgen {command}`",
            where=str(output),
            hint=f"`{call}` makes it.",
        )

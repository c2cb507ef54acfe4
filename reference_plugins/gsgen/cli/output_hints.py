"""The next thing to type where a command line lacks the option -o."""

__all__ = ["output_hint"]

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

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
    last_file, remaining_words = files[-1], list(words)
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

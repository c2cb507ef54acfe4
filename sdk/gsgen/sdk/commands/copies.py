"""The output path of commands that change a model: `-o OUT.onnx`, or none with `--dry-run`."""

__all__ = ["copy_of"]

from pathlib import Path

from gsgen.contract.errors import ConfigInvalid


def copy_of(output: Path | None, *, dry_run: bool) -> Path | None:
    """Return the output path; None for a dry run.

    Raises:
        ConfigInvalid: The output path is missing.
    """
    if dry_run:
        return None
    if output is None:
        hint = "Give -o OUT.onnx, or --dry-run to list the changes."
        raise ConfigInvalid(
            "is missing, expected the path of the copy", where="--output", hint=hint
        )
    return output

"""The output option of commands that write a changed model: `-o OUT.onnx`, or `--dry-run`."""

__all__ = ["copy_of"]

from pathlib import Path

from gsgen.contract.errors import ConfigInvalid


def copy_of(output: Path | None, *, dry_run: bool) -> Path | None:
    """Return the path of the changed model that a command writes; None for a dry run."""
    if dry_run:
        return None
    if output is None:
        hint = "Give -o OUT.onnx, or --dry-run to list the changes."
        raise ConfigInvalid(
            "is missing, expected the path of the copy", where="--output", hint=hint
        )
    return output

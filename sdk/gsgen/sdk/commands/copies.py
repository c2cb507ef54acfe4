"""Where a command that changes a model puts its copy: `-o OUT.onnx`, or nowhere (`--dry-run`)."""

__all__ = ["copy_of"]

from pathlib import Path

from gsgen.contract.errors import ConfigInvalid


def copy_of(output: Path | None, dry_run: bool) -> Path | None:
    """Return where to write; None for a dry run, which may be added to any command line.

    Raises:
        ConfigInvalid: No place was given for what would be written.
    """
    if dry_run:
        return None
    if output is None:
        hint = "Give -o OUT.onnx, or --dry-run to see what would change."
        raise ConfigInvalid("where should the copy go?", where="--output", hint=hint)
    return output

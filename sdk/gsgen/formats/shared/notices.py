"""Warnings about files that can be read, such as parts of a file that are not used."""

__all__ = ["FormatWarning", "MeshWarning", "warn_unused"]

import os
import warnings
from collections.abc import Sequence
from typing import final

from gsgen.contract.errors import FileNote


class FormatWarning(FileNote):
    """Warning about a splat file: a part that is not used, dropped rows, or suspicious values."""


@final
class MeshWarning(FormatWarning):
    """Warning about meshes beside splats, which a reader of splats leaves out."""


def warn_unused(
    path: str | os.PathLike[str],
    names: Sequence[str],
    category: type[FormatWarning] = FormatWarning,
) -> None:
    """Warn about the parts of a file that its reader did not use; nothing for no names."""
    if names:
        text = f"{os.fspath(path)}: not used: {', '.join(names)}"
        warnings.warn(text, category, stacklevel=2)

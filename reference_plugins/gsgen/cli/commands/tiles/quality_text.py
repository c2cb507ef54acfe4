"""Words for the bytes of a tileset's qualities, in the output of `gsgen tiles build` and `info`."""

__all__ = ["quality_text"]

from collections.abc import Sequence


def quality_text(quality_bytes: Sequence[int], splats: int) -> str:
    """Return what each quality of a tileset costs, finest first.

    Args:
        quality_bytes: Of all contents at each quality.
        splats: Of the scene.
    """
    count = len(quality_bytes)
    sizes = " / ".join(f"{size / 1e6:,.1f}" for size in quality_bytes)
    per_splat = " / ".join(f"{size / max(splats, 1):.1f}" for size in quality_bytes)
    noun = "one quality of" if count == 1 else f"{count} qualities of"
    return f"{noun} {sizes} MB ({per_splat} bytes a splat)"

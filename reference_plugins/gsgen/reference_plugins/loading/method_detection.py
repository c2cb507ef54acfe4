"""Recognises the method of a training run by its files; several methods have similar layouts."""

__all__ = ["is_octree_anygs", "point_columns", "refuse_other_method"]

from pathlib import Path

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.sdk.plugins.plugin import installed_plugins


def refuse_other_method(name: str, run: Path, iteration: Path) -> None:
    """Raise if the files of a training run belong to another method than that of the plugin.

    The hint has the command of the plugin that recognises the run.
    """
    recognising_plugins = {
        plugin.name: plugin
        for plugin in installed_plugins()
        if plugin.recognises is not None and plugin.recognises(run, iteration)
    }
    if recognising_plugins and name not in recognising_plugins:
        match = next(iter(recognising_plugins.values()))
        message = f"is a checkpoint of {match.title or match.name}"
        hint = f"Export it with `gsgen export {match.name}`."
        raise CheckpointInvalid(message, where=str(run), hint=hint)


def point_columns(iteration: Path) -> tuple[str, ...]:
    """Return the column names of an iteration's point cloud; empty if it cannot be read.

    The reader of the file reports its faults.
    """
    from gsgen.formats import FormatError, ply_properties

    path = iteration / "point_cloud.ply"
    try:
        return ply_properties(path) if path.is_file() else ()
    except FormatError:
        return ()


def is_octree_anygs(iteration: Path) -> bool:
    """Return whether an iteration's point cloud has anchors as Octree-AnyGS writes them.

    Networks compute the opacity of its neural anchors, and the PLY has no column for it; anchors of
    explicit Gaussians have one, and colours. Scaffold-GS and Octree-GS write an unused opacity.
    """
    columns = set(point_columns(iteration))
    has_opacity = "opacity" in columns
    is_anchor = "f_offset_0" in columns and "anchor_size_0" not in columns
    return is_anchor and has_opacity == ("f_dc_0" in columns)

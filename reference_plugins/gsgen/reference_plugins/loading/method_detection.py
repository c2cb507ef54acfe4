"""Which method a training run is of, told by its files: layouts are alike, and so are mistaken."""

__all__ = ["is_of_r3", "refuse_other_method"]

import zipfile
from pathlib import Path

from gsgen.formats import FormatError, ply_properties
from gsgen.reference_plugins.loading.cfg_args import read_cfg_args
from gsgen.reference_plugins.loading.errors import CheckpointInvalid

_NAMES = {
    "scaffold-gs": "Scaffold-GS",
    "octree-gs": "Octree-GS",
    "duplex-gs": "Duplex-GS",
    "hexplane-4dgs": "4DGaussians",
    "deformable-3dgs": "Deformable-3D-Gaussians",
    "r3-avatar": "R3-Avatar",
    "gauhuman": "GauHuman",
}
# A class that R3-Avatar's training pickles, and GauHuman's has not.
_OF_R3 = b"gaussian_decoder"
_MOST_BYTES = 1 << 26


def refuse_other_method(plugin: str, run: Path, place: Path) -> None:
    """Refuse a run of which it is certain that another plugin is meant.

    Args:
        plugin: Whose reader asks.
        run: The folder of the training run.
        place: That of the iteration.

    Raises:
        CheckpointInvalid: It is of another method; the error names the command.
    """
    seen = _method_of(run, place)
    if seen not in (None, plugin):
        hint = f"Export it with `gsgen export {seen}`."
        what = f"is a checkpoint of {_NAMES[seen or plugin]}"
        raise CheckpointInvalid(what, where=str(run), hint=hint)


def _method_of(run: Path, place: Path) -> str | None:
    columns = _columns(place / "point_cloud.ply")
    if "anchor_size_0" in columns:
        return "duplex-gs"
    if "f_offset_0" in columns:
        return "octree-gs" if "level" in columns else "scaffold-gs"
    if (place / "deformation.pth").is_file():
        return "hexplane-4dgs"
    if (run / "deform").is_dir():
        return "deformable-3dgs"
    if any(is_of_r3(path) for path in sorted(run.glob("chkpnt*.pth"))):
        return "r3-avatar"
    return "gauhuman" if "smpl_type" in read_cfg_args(run).values else None


def _columns(path: Path) -> tuple[str, ...]:
    try:
        return ply_properties(path) if path.is_file() else ()
    except FormatError:  # whoever wants it says what is wrong with it
        return ()


def is_of_r3(path: Path) -> bool:
    """Whether a ``chkpntN.pth`` is of R3-Avatar; what is in it is not unpickled."""
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if entry.filename.endswith("/data.pkl") and entry.file_size < _MOST_BYTES:
                    return _OF_R3 in archive.read(entry)
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError):
        return False
    return False

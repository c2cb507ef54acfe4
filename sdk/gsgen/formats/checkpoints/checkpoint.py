"""Reads splats from checkpoints of gsplat, nerfstudio's splatfacto and the 3DGS training code.

Layouts, read from the code that writes them:

- gsplat 1.5.3 and main of August 2026 (90d7b4b, ``examples/simple_trainer.py``): a dict with
  ``splats``: means, scales, quats, opacities, sh0 and shN.
- nerfstudio (8e20ec6, ``models/splatfacto.py``, and ``engine/trainer.py``): a dict with
  ``pipeline``, whose names begin with ``_model.gauss_params.``, or with ``_model.`` before 2024.
- graphdeco-inria/gaussian-splatting (1152adc, ``scene/gaussian_model.py``): the tuple of
  ``capture()``, and the iteration.

All store logarithms of scales, logits of opacities and quaternions (w, x, y, z), as PLY does.
"""

__all__ = ["read_checkpoint"]

import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES
from gsgen.formats.checkpoints.methods import unsupported_content_error
from gsgen.formats.checkpoints.pickled_data import TensorReference
from gsgen.formats.checkpoints.torch_archive import TorchArchive
from gsgen.formats.shared.bytes import not_recognised
from gsgen.formats.shared.errors import NotSupported, PropertyMissing, ValueInvalid, join_names
from gsgen.formats.shared.files import FilePath, open_file, stream_size
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.npz_arrays import ZIP_MAGIC, unpacking
from gsgen.formats.shared.origins import relative_positions
from gsgen.formats.shared.quantities import SH_C0, sigmoid
from gsgen.formats.shared.splat_values import drawable
from gsgen.formats.shared.splats import SH_COUNTS, Splats

_GSPLAT_KEYS: Final = ("means", "quats", "scales", "opacities", "sh0", "shN")
_SPLATFACTO_KEYS: Final = ("means", "quats", "scales", "opacities", "features_dc", "features_rest")
_CAPTURE_LENGTH = 12


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class _CheckpointLayout:
    """The splat tensors of a checkpoint and their names, from positions to higher SH degrees."""

    names: tuple[str, ...]
    tensors: Mapping[str, Any]
    antialiased: bool = False
    notes: tuple[str, ...] = ()
    # splatfacto trains colours through a sigmoid where it has no higher harmonics
    has_sigmoid_colors: bool = False


def read_checkpoint(path: FilePath, *, drop_invalid: bool = False) -> Splats:
    """Read Gaussian splats from a training checkpoint without torch; no code in the file is run.

    The file does not say whether training drew antialiased; the settings beside it do
    (``cfg.yml`` of gsplat, ``config.yml`` of nerfstudio), and are read if they are there. Invalid
    rows are refused, or dropped with a warning.

    Raises:
        FileUnreadable: The file is missing or empty, or may not be read.
        FormatNotRecognised: The file is not an archive of torch.save.
        NotSupported: The file holds something else than plain splats; the message says what.
        ArchiveDamaged: The archive, or a tensor in it, cannot be unpacked.
        PropertyMissing: The file lacks tensors of splats.
        SizeExceeded: A member claims more bytes than the file has.
        ValueInvalid: A tensor has a wrong shape or type, or a value that cannot be drawn.
    """
    with open_file(path) as file:
        head = file.read(RECOGNITION_BYTES)
        if not head.startswith(ZIP_MAGIC):
            expected = "50 4b 03 04, the start of a checkpoint of torch 1.6 or later"
            raise not_recognised(head, expected, head[:4].hex(" "))
        with unpacking("archive"):
            opened_archive = zipfile.ZipFile(file)
        with opened_archive as archive:
            torch_archive = TorchArchive(archive, stream_size(file))
            layout = _checkpoint_layout(torch_archive, Path(path))
            splats = _splats(torch_archive, layout)
        splats = drawable(splats, path, drop_invalid=drop_invalid)
    for note in layout.notes:
        warnings.warn(f"{path}: {note}", FormatWarning, stacklevel=2)
    return splats


def _checkpoint_layout(archive: TorchArchive, path: Path) -> _CheckpointLayout:
    """Find the splat tensors in a checkpoint of gsplat, nerfstudio or 3DGS; raise for others."""
    content = _unwrap_state_dict(archive.data())
    if isinstance(content, dict) and isinstance(content.get("splats"), dict):
        return _gsplat_layout(content, path)
    if isinstance(content, dict) and isinstance(content.get("pipeline"), dict):
        return _nerfstudio_layout(content["pipeline"], path)
    if isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], tuple):
        return _capture_layout(content[0])
    raise unsupported_content_error(content, is_script=archive.is_script)


def _unwrap_state_dict(content: Any) -> Any:
    """Return the dict of a checkpoint as trainers save it, from one of a bare model.

    ``state_dict()`` saves the tensors without the trainer's keys, and DistributedDataParallel
    puts ``module.`` into names.
    """
    if not isinstance(content, dict):
        return content
    for key in ("splats", "pipeline"):
        if isinstance(content.get(key), dict):
            return {**content, key: _remove_wrapper_prefixes(content[key])}
    names = _remove_wrapper_prefixes(content)
    if {"means", "quats", "scales"} <= names.keys():
        return {"splats": names}
    for prefix in ("gauss_params.", "_model.gauss_params.", "splats."):
        tensors = {
            name.removeprefix(prefix): value
            for name, value in names.items()
            if isinstance(name, str) and name.startswith(prefix)
        }
        if tensors and prefix == "splats.":
            return {"splats": tensors}
        if tensors:
            return {"pipeline": {f"_model.gauss_params.{k}": v for k, v in tensors.items()}}
    nested_states = [names.get(key) for key in ("state_dict", "model_state_dict", "model")]
    states = [state for state in nested_states if isinstance(state, dict) and state]
    return _unwrap_state_dict(states[0]) if states else content


def _remove_wrapper_prefixes(tensors: dict[Any, Any]) -> dict[Any, Any]:
    """Return a state dict without the part ``module`` in its names."""
    return {
        re.sub(r"(^|\.)module\.", r"\1", name) if isinstance(name, str) else name: value
        for name, value in tensors.items()
    }


def _gsplat_layout(content: dict[Any, Any], path: Path) -> _CheckpointLayout:
    tensors = dict(content["splats"])
    if "means3d" in tensors:  # the name until gsplat 1.0
        tensors["means"] = tensors.pop("means3d")
    if "features" in tensors or "app_module" in content:
        raise NotSupported(
            "the colours come from an appearance network (app_opt of gsplat)",
            where="splats",
            expected="harmonics sh0 and shN",
            hint="convert the PLY that the trainer saves (--save_ply), whose colours are computed",
        )
    notes = []
    if "post_processing" in content:
        notes.append("colour correction per image (post_processing) has no effect")
    rank_files = sorted(path.parent.glob(re.sub(r"_rank\d+$", "_rank*", path.stem) + path.suffix))
    if len(rank_files) > 1:
        notes.append(
            f"one of {len(rank_files)} files of a training on several GPUs; convert them all"
        )
    return _CheckpointLayout(
        names=_GSPLAT_KEYS,
        tensors=tensors,
        antialiased=_read_flag(path.parent.parent / "cfg.yml", r"antialiased:\s*true"),
        notes=tuple(notes),
    )


def _nerfstudio_layout(state: dict[Any, Any], path: Path) -> _CheckpointLayout:
    prefix = "_model.gauss_params."
    has_state_prefix = any(str(name).startswith(prefix) for name in state)
    prefix = prefix if has_state_prefix else "_model."
    tensors = {
        name.removeprefix(prefix): value
        for name, value in state.items()
        if isinstance(name, str) and name.startswith(prefix)
    }
    unknown_names = [name for name in tensors if name not in _SPLATFACTO_KEYS]
    if "means" not in tensors or (has_state_prefix and unknown_names):
        raise NotSupported(
            f"the checkpoint holds another nerfstudio model than splatfacto, with {join_names(unknown_names or list(map(str, state)), limit=6)}",
            where="pipeline",
            expected=f"{prefix}* of splatfacto: {join_names(list(_SPLATFACTO_KEYS))}",
        )
    rest = tensors.get("features_rest")
    has_grids = any(str(name).startswith("_model.bil_grids") for name in state)
    return _CheckpointLayout(
        names=_SPLATFACTO_KEYS,
        tensors=tensors,
        antialiased=_read_flag(
            path.parent.parent / "config.yml", r"\s*rasterize_mode:\s*antialiased"
        ),
        notes=("colour correction per image (bil_grids) has no effect",) if has_grids else (),
        has_sigmoid_colors=isinstance(rest, TensorReference) and rest.shape[1:2] == (0,),
    )


def _capture_layout(values: tuple[Any, ...]) -> _CheckpointLayout:
    tensors = [isinstance(value, TensorReference) for value in values[:7]]
    if len(values) != _CAPTURE_LENGTH or not all(tensors[1:]) or tensors[0]:
        raise unsupported_content_error(values, is_script=False)
    # capture() lists scales before quaternions, and harmonics before both.
    _, means, dc, rest, scales, quaternions, opacities, *_ = values
    ordered_tensors = (means, quaternions, scales, opacities, dc, rest)
    return _CheckpointLayout(
        names=_SPLATFACTO_KEYS, tensors=dict(zip(_SPLATFACTO_KEYS, ordered_tensors, strict=True))
    )


def _splats(archive: TorchArchive, layout: _CheckpointLayout) -> Splats:
    missing = [name for name in layout.names if name not in layout.tensors]
    if missing:
        raise PropertyMissing(
            f"the checkpoint lacks the tensors {join_names(missing)}; it has {join_names(list(map(str, layout.tensors)))}",
            expected=f"the tensors {join_names(list(layout.names))}",
        )
    for name in layout.names:
        if not isinstance(layout.tensors[name], TensorReference):
            kind = type(layout.tensors[name]).__name__
            raise ValueInvalid(f"the value is a {kind}", where=name, expected="a tensor")
    references = [layout.tensors[name] for name in layout.names]
    _require_shapes(layout.names, references)
    arrays = [
        archive.array(tensor, name, keep_doubles=index == 0)
        for index, (name, tensor) in enumerate(zip(layout.names, references, strict=True))
    ]
    wide_position, rotation, log_scale, opacity, dc, rest = arrays
    position, origin, rounding = relative_positions(wide_position)
    if layout.has_sigmoid_colors:
        dc = (sigmoid(dc) - np.float32(0.5)) / np.float32(SH_C0)
    return Splats(
        position=position,
        rotation=rotation,
        log_scale=log_scale,
        logit_opacity=opacity.reshape(-1),
        sh=_joined(dc, rest),
        antialiased=layout.antialiased,
        origin=origin,
        rounding=rounding,
    )


def _joined(
    constant: Float32[np.ndarray, "..."], higher_sh: Float32[np.ndarray, "n k 3"]
) -> Float32[np.ndarray, "n l 3"]:
    return np.concatenate([constant.reshape(len(higher_sh), 1, 3), higher_sh], axis=1)


def _require_shapes(names: tuple[str, ...], tensors: list[TensorReference]) -> None:
    """Raise unless the tensors have the shapes of splats, all with the same number of rows."""
    n = tensors[0].shape[0] if tensors[0].shape else 0
    if tensors[2].shape == (n, 2):
        raise NotSupported(
            "the splats have two scales, as in 2DGS, which draws flat discs",
            where=names[2],
            expected="three scales",
        )
    higher_sh = tuple((n, count - 1, 3) for count in SH_COUNTS)
    allowed_shapes = (
        ((n, 3),),
        ((n, 4),),
        ((n, 3),),
        ((n,), (n, 1)),
        ((n, 1, 3), (n, 3)),
        higher_sh,
    )
    for name, tensor, shapes in zip(names, tensors, allowed_shapes, strict=True):
        if tensor.shape not in shapes:
            expected = " or ".join(str(list(shape)) for shape in shapes)
            raise ValueInvalid(
                f"the tensor has shape {list(tensor.shape)}", where=name, expected=expected
            )


def _read_flag(path: Path, line: str) -> bool:
    """Return whether the settings file beside a training checkpoint contains a given line."""
    if not path.is_file():
        return False
    text = path.read_text("utf-8", errors="replace")
    return re.search(rf"^{line}\s*$", text, re.MULTILINE) is not None

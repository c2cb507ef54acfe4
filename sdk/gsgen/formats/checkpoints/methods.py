"""Identifies the method of a checkpoint that is not plain 3DGS, and the plugin that reads it."""

__all__ = ["unsupported_content_error"]

from typing import Any, Final

from gsgen.contract._entry_points import registered_entry_points
from gsgen.formats.checkpoints.pickled_data import TensorReference
from gsgen.formats.shared.errors import NotSupported, join_names

# Beginnings of names in the files of each method, its name, and its plugin.
_METHOD_KEYS: Final = (
    (("deformation_net.", "_deformation"), "4DGaussians", "hexplane-4dgs"),
    (("opacity_mlp", "mlp_opacity", "cov_mlp"), "Scaffold-GS", "scaffold-gs"),
    (("gaussian_warp.", "gaussian_scaling."), "Deformable-3DGS", "deformable-3dgs"),
    (("nodes", "_node_radius", "_node_weight"), "SC-GS", "sc-gs"),
    (("pose_decoder.", "lweight_offset_decoder."), "GauHuman", "gauhuman"),
)

# ``capture()`` of rotor 4DGS, and the value in it that says whether rotations are 4-D.
_ROTOR_LENGTH, _ROTOR_FLAG = 19, 16


def unsupported_content_error(content: Any, *, is_script: bool) -> NotSupported:
    """Return the error for a ``torch.save`` or ``torch.jit.save`` file that is not plain 3DGS."""
    if is_script:
        return NotSupported(
            "a network (TorchScript), as Scaffold-GS and Octree-GS save them",
            expected="a checkpoint of splats",
            hint=_hint("scaffold-gs"),
        )
    for prefixes, method, plugin in _METHOD_KEYS:
        matches = [name for name in _names(content) if name.startswith(prefixes)]
        if matches:
            return _method_error(method, plugin, f"{join_names(matches, limit=4)} of {method}")
    if isinstance(content, tuple):
        return _tuple_error(content)
    names_text = join_names(_names(content), limit=12)
    return NotSupported(
        f"a {type(content).__name__} of {names_text}",
        expected="a checkpoint of gsplat (splats), splatfacto (pipeline) or 3DGS (capture)",
    )


def _tuple_error(values: tuple[Any, ...]) -> NotSupported:
    """Return the error for a checkpoint tuple (``capture()``) of another method than 3DGS."""
    if len(values) == _ROTOR_LENGTH and isinstance(values[_ROTOR_FLAG], bool):
        return _method_error("rotor 4DGS", "rotor-4dgs", "a capture of rotor 4DGS")
    tensors = [value for value in values[:4] if isinstance(value, TensorReference)]
    if any(isinstance(value, dict) for value in values[2:3]):
        return _method_error("4DGaussians", "hexplane-4dgs", "a capture of 4DGaussians")
    if tensors and values[0] is tensors[0] and any(len(t.shape) == 3 for t in tensors[1:2]):
        return _method_error("Scaffold-GS", "scaffold-gs", "anchors and offsets of Scaffold-GS")
    return NotSupported(
        f"the checkpoint tuple (capture) has {len(values)} values",
        expected="the 12 of 3DGS: SH degree, 6 tensors, statistics and optimizer",
        hint="another method has saved it; convert its PLY, or export it with the method's plugin",
    )


def _method_error(method: str, plugin: str, message: str) -> NotSupported:
    return NotSupported(
        message, expected=f"plain splats; {method} computes them", hint=_hint(plugin)
    )


def _hint(plugin: str) -> str:
    if plugin in {point.name for point in registered_entry_points("gsgen.generators")}:
        return f"`gsgen export {plugin} --checkpoint FOLDER -o OUT.onnx` exports the folder of the training"
    return f"no installed plugin reads it (it would be called {plugin})"


def _names(content: Any) -> list[str]:
    return [name for name in content if isinstance(name, str)] if isinstance(content, dict) else []

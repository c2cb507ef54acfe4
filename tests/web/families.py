"""Small exported models of every family of generators, and the frames that tests draw of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.conformance.viewer_kit.case import KitFrame, kit_camera
from gsgen.contract.spec.manifest import GeneratorManifest, Input
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins import synthetic
from gsgen.sdk import GaussianGenerator, export, installed_plugins
from gsgen.sdk.binding import FrameSession
from gsgen.sdk.exporting.pipeline import GraphSource

FRAMES = 6


@dataclass(frozen=True, kw_only=True)
class Family:
    """How a test makes a model of a family.

    Attributes:
        write: Writes a checkpoint, or frames, into a folder.
        options: Further arguments of the plugin's ``build``.
        has_motion: Whether the model plays a motion.
        tolerance: What Gaussians may differ by, relative to the largest number of their column.
            Poses and positional encodings take sines, which SwiftShader computes to 2e-4.
    """

    write: Callable[[Path], Path | list[Path]]
    options: Mapping[str, Any] = field(default_factory=dict)
    has_motion: bool = False
    tolerance: float = 2e-5


_TRIGONOMETRY = 2e-3

FAMILIES: Mapping[str, Family] = {
    "deformable-3dgs": Family(write=synthetic.write_deformable, tolerance=_TRIGONOMETRY),
    "duplex-gs": Family(write=synthetic.write_duplex, options={"blend": "wsr"}),
    "ex4dgs": Family(write=synthetic.write_ex4dgs, tolerance=_TRIGONOMETRY),
    "gart": Family(
        write=partial(synthetic.write_gart, options=synthetic.PersonOptions(degree=1)),
        has_motion=True,
        tolerance=_TRIGONOMETRY,
    ),
    "gauhuman": Family(write=synthetic.write_gauhuman, has_motion=True, tolerance=_TRIGONOMETRY),
    "gaussian-avatars": Family(write=synthetic.write_gaussian_avatar),
    "hexplane-4dgs": Family(write=synthetic.write_hexplane),
    "lhm": Family(write=synthetic.write_lhm, has_motion=True, tolerance=_TRIGONOMETRY),
    "octree-anygs": Family(write=synthetic.write_anygs),
    "octree-gs": Family(write=synthetic.write_octree),
    "r3-avatar": Family(write=synthetic.write_r3, has_motion=True, tolerance=_TRIGONOMETRY),
    "rotor-4dgs": Family(write=synthetic.write_rotor, options={"time_duration": (0.0, 1.0)}),
    "sc-gs": Family(write=synthetic.write_sc_gs, tolerance=_TRIGONOMETRY),
    "scaffold-gs": Family(write=synthetic.write_scaffold),
    "sequence": Family(
        write=lambda folder: [synthetic.write_sequence(folder, rows=300, frames=6)[0].parent],
        options={"moments": 0},
    ),
    "spacetime-gaussians": Family(write=synthetic.write_spacetime),
}


def plugin_names() -> set[str]:
    """Return the plugins that export generators of Gaussians from checkpoints of a method."""
    names = {plugin.name for plugin in installed_plugins() if "image" not in plugin.inputs}
    return names - {"static", "2dgs"}  # whose models have no inputs


def family_generator(name: str, folder: Path) -> GaussianGenerator | GraphSource:
    """Write a checkpoint of a family, and read its generator, or the source of its graph."""
    family = FAMILIES[name]
    [plugin] = [plugin for plugin in installed_plugins() if plugin.name == name]
    options = dict(family.options)
    if family.has_motion:
        options["motion"] = synthetic.write_motion(folder.parent / "walk.npz")
    assert plugin.build is not None
    generator = plugin.build(family.write(folder), **options)
    assert isinstance(generator, GaussianGenerator | GraphSource)
    return generator


def export_family(name: str, folder: Path) -> Path:
    """Export a model of a family, and return its path."""
    path = folder / f"{name}.onnx"
    generator, settings = family_generator(name, folder / name), Settings(level=Level.STATIC)
    if isinstance(generator, GraphSource):
        generator.export(path, target="webgpu", settings=settings)
    else:
        export(generator, path, target="webgpu", settings=settings)
    return path


def family_frames(model: Path) -> list[KitFrame]:
    """Return frames of a model: cameras around it, its times in turn, random expressions."""
    rng = np.random.default_rng(0)
    with FrameSession(model, provider="cpu") as session:
        manifest = session.manifest
        assert isinstance(manifest, GeneratorManifest)
        rows = np.array(session.run(copy=True)[manifest.outputs.gaussians.name])
    drawn = rows[rows[:, 3] > 0, :3]
    center, reach = drawn.mean(axis=0), float(np.ptp(drawn, axis=0).max())
    frames = []
    for number in range(FRAMES):
        values = map(partial(_value, number=number, rng=rng), manifest.inputs)
        angle = 0.4 * number
        offset = 1.5 * reach * np.array([np.sin(angle), -0.3, -np.cos(angle)])
        frames.append(
            KitFrame(
                camera=kit_camera(tuple(center + offset), tuple(center)),
                values={name: value for name, value in values if value is not None},
            )
        )
    return frames


def _value(declared: Input, *, number: int, rng: np.random.Generator) -> Any:
    """Return the name of an input and its value in a frame; None for its default."""
    low, high = declared.range or (0, 0)
    if declared.role == "time":
        return declared.name, np.array([low + (high - low) * number / FRAMES], np.float32)
    if declared.role == "expression":
        return declared.name, rng.uniform(low / 2, high / 2, declared.shape).astype(np.float32)
    return declared.name, None

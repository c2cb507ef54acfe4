"""A person for pages."""

from pathlib import Path

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.people.gauhuman_plugin import build
from gsgen.reference_plugins.synthetic import PersonOptions, write_gauhuman, write_motion
from gsgen.sdk import export


def export_walking_person(folder: Path) -> bytes:
    """Export a small model of a person who walks on the spot, in 24 frames."""
    write_gauhuman(folder / "run", PersonOptions(count=1200, vertices=600))
    generator = build(folder / "run", motion=write_motion(folder / "walk.npz", frames=24))
    path = folder / "walk.onnx"
    export(generator, path, target="webgpu", settings=Settings(level=Level.STATIC))
    return path.read_bytes()

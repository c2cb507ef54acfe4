"""Static scenes as models, written without validation: tests also need models that break rules."""

from pathlib import Path

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.exporting.constant_generator import ConstantRows, constant_manifest, write_constant


def write_scene(
    packed: ConstantRows, path: Path, *, capacity: int | None = None
) -> GeneratorManifest:
    """Write packed rows as a generator, and return its manifest."""
    manifest = constant_manifest(packed, path.stem, family="static", capacity=capacity)
    write_constant(packed.rows, packed.appearance, manifest, path)
    return manifest

"""Builds of small scenes on one engine, for tests."""

from pathlib import Path

from gsgen.tiles.build.build import BuildReport, build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import SilentProgress

SMALL = BuildParameters(leaf=700, qualities=(0,), implicit=False, transform=upright_transform())
PARTITION = 4000
CHUNK = 1 << 20  # bytes: a scene of 40,000 splats of degree 0 is three chunks


def build(
    scenes: list[Path],
    output: Path,
    parameters: BuildParameters = SMALL,
    engine: str = "serial",
    **options: object,
) -> BuildReport:
    """Build ``scenes`` in chunks and partitions small enough for several tasks."""
    with open_engine(engine, 2) as running:
        return build_tileset(
            scenes,
            output,
            parameters,
            engine=running,
            progress=SilentProgress(),
            chunk_bytes=CHUNK,
            partition=PARTITION,
            **options,
        )

"""What fuzzing starts from: every model of the corpus, each in a folder with its side files."""

__all__ = ["Base", "bases"]

from dataclasses import dataclass
from pathlib import Path

from gsgen.conformance.fixtures import fixtures

# A mutant of a larger model shows nothing that one of a smaller does not, and takes longer.
_MAX_BYTES = 128 << 10


@dataclass(frozen=True, slots=True)
class Base:
    """One model that was not mutated yet.

    Attributes:
        name: The fixture's name.
        target: What it is judged for.
        content: Bytes of the file.
        folder: Where its side files lie; None where it has none or nothing was written.
    """

    name: str
    target: str
    content: bytes
    folder: Path | None = None


def bases(folder: Path | None = None) -> list[Base]:
    """Draw every fixture; write side files below ``folder``, where one is given."""
    results = []
    for fixture in fixtures():
        spec = fixture.draw()
        content = spec.build().SerializeToString()
        if len(content) > _MAX_BYTES:
            continue
        external_data = None
        if folder is not None and (spec.extra_files or spec.zero_files or spec.links):
            external_data = folder / fixture.name
            external_data.mkdir(parents=True, exist_ok=True)
            spec.write(external_data / "base.onnx")
        results.append(Base(fixture.name, fixture.target, content, external_data))
    return results

"""Renders an eager module's output at an export, as reference images of the exported model.

They are drawn from torch's own outputs, so that level ``render`` sees what later changes the
picture: a tool that rewrites the file, swapped channels, a mirrored axis, other signs of SH.
"""

__all__ = ["SourcePictures", "add_source_pictures"]

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model, write_manifest_text
from gsgen.contract.probing.probe_plan import make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest import GeneratorManifest, ReferenceImage
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.tools.recording import evenly_spaced

_MAX_PICTURES = 16

Outputs = Mapping[str, np.ndarray]
DrawPicture = Callable[
    [GeneratorManifest, Sequence[tuple[Probe, Outputs]]], list[tuple[bytes, ReferenceImage]]
]
"""Draws frames as PNGs with declarations; see gsgen.runtime.checks.eager_pictures."""


@dataclass(frozen=True, slots=True)
class SourcePictures:
    """How many pictures of an eager module an export declares, and the function that draws them.

    The pictures are spread over the probes of the model.
    """

    count: int
    draw: DrawPicture


def add_source_pictures(
    draft: Path, run: Callable[[Probe], Outputs], pictures: SourcePictures
) -> tuple[ReferenceImage, ...]:
    """Render a torch module's outputs to PNG files, and list the files in the model's manifest.

    Args:
        draft: The exported model, whose manifest is changed; pictures go next to it.
        run: Computes the module's outputs in eager torch, by the names of the model's outputs.
        pictures: How many pictures to draw, and what draws them.

    Returns:
        The declarations of the pictures.

    Raises:
        ConfigInvalid: The number is out of range.
        GsgenError: No graphics device can be opened, or the outputs cannot be drawn.
    """
    subject = inspect_model(open_model(draft), load_target("core"), Limits())
    assert subject.generator is not None
    probes = make_plan(subject, Level.VALUES).probes
    candidates = [probe for probe in probes if not probe.zeros] or list(probes)
    count, most = pictures.count, min(_MAX_PICTURES, len(candidates))
    if not 1 <= count <= most:
        message = f"is {count}, expected from 1 to {most}, the model's probes"
        raise ConfigInvalid(message, where="--pictures", hint=f"The most is --pictures {most}.")
    frames = [(probe, run(probe)) for probe in evenly_spaced(candidates, count)]
    drawn = pictures.draw(subject.generator, frames)
    folder = draft.parent / f"{draft.stem}-references"
    images = tuple(
        replace(declaration, path=f"{folder.name}/{number}.png")
        for number, (_, declaration) in enumerate(drawn)
    )
    document = json.loads(subject.file.manifest_text or "{}")
    text = json.dumps(document | {"reference_images": to_json(images)}, ensure_ascii=False)
    folder.mkdir()
    try:
        for image, (png, _) in zip(images, drawn, strict=True):
            (draft.parent / image.path).write_bytes(png)
        write_manifest_text(draft, text, draft)
    except BaseException:  # an export that is out of time goes on without pictures
        shutil.rmtree(folder)
        raise
    return images

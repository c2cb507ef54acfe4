"""What a good model is, and what all producers' models share: rows, colours, manifests."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from onnx import ModelProto

from gsgen.conformance.fixtures.builders.clouds import cloud
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.layout import encode
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Input,
    Manifest,
    Space,
)
from gsgen.contract.spec.manifest_io import dumps

UP = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True, slots=True)
class Good:
    """One good model.

    Attributes:
        name: What is special about it.
        producer: What wrote the graph.
        draw: Writes it, manifest included.
        target: The consumer that it is meant for.
    """

    name: str
    producer: str
    draw: Callable[[], ModelProto]
    target: str = "core"


@dataclass(frozen=True, slots=True)
class Scene:
    """Packed rows and colours of a random cloud within ±1 of the origin."""

    rows: np.ndarray
    colors: np.ndarray
    degree: int | None

    @property
    def half(self) -> bool:
        return self.rows.dtype == np.float16

    def manifest(self, *inputs: Input, room: float = 1.0, **changes: Any) -> Manifest:
        """Return a manifest; the bounds are ``room`` times as wide as the cloud may be."""
        dtype = "float16" if self.half else "float32"
        appearance = AppearanceOutput("color", "rgb" if self.degree is None else "sh", self.degree)
        outputs = GeneratorOutputs(
            GaussiansOutput("gaussians", len(self.rows), dtype),
            appearance,
            CountOutput("num_points"),
        )
        corner = (room, room, room)
        generator_manifest = GeneratorManifest(
            name="good",
            inputs=inputs,
            outputs=outputs,
            space=Space(),
            bounds=Bounds((-room, -room, -room), corner),
        )
        return replace(generator_manifest, **changes)


def scene(
    count: int = 40, degree: int | None = 1, dtype: type = np.float32, seed: int = 1
) -> Scene:
    """Return a random scene; another seed gives another one."""
    rows, colors = encode(cloud(count, degree, seed), dtype)
    return Scene(rows, colors, degree)


def live(count: int) -> np.ndarray:
    return np.asarray([count], np.int32)


def declared(model: ModelProto, manifest: Manifest) -> ModelProto:
    """Embed ``manifest`` in place of whatever was there."""
    retained = [prop for prop in model.metadata_props if prop.key != MANIFEST_KEY]
    del model.metadata_props[:]
    model.metadata_props.extend(retained)
    model.metadata_props.add(key=MANIFEST_KEY, value=dumps(manifest))
    return model

"""Runs post-process models: networks that change the colours of a drawn frame."""

__all__ = ["TILE_OVERLAP", "PostProcessor", "open_posts"]

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self, final

import numpy as np
from jaxtyping import Float, Float32

from gsgen.contract.spec.manifest import Input, PostProcessManifest
from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.fitted_pictures import resample
from gsgen.runtime.playback.image_tiling import run_tiled
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.sources.key_frames import Animation
from gsgen.runtime.sources.placed_source import fixed_and_keyed
from gsgen.runtime.sources.scene_file import SceneFile, locate_errors
from gsgen.runtime.sources.source import Values, named

if TYPE_CHECKING:
    from gsgen.sdk.binding import FrameSession
    from gsgen.sdk.binding.bound.bound_session import TensorSpec
    from gsgen.sdk.binding.bound.model_facts import ModelFacts
    from gsgen.sdk.binding.confined.models import ConfinedModels

TILE_OVERLAP: Final = 32
"""Pixels that tiles of an image share; small tiles share fewer."""


@final
class PostProcessor:
    """A post-process model that runs on frames of any size.

    A model of fixed size runs tile by tile; one of open size sees the whole image, and is opened
    again when the size changes. Its input is sRGB, not multiplied by alpha, clipped, and scaled to
    the range that its manifest declares. Its output is scaled back, and is in the manifest's
    colour space. Without an alpha output, the frame keeps its alpha; that of a frame that the
    model enlarges is interpolated.

    Args:
        path: The model.
        provider: ONNX Runtime's execution provider: cpu, webgpu, cuda or auto.
        sizes: Symbol → size of an open dimension other than those of the image.
        confined: Runs the model in a child process with limits; None runs it in this process.
        values: Inputs with a fixed value: tensor name or role → value.
        where: Location of ``values`` in error messages.
        animation: The timeline of its scene, with key frames of inputs: tensor name or role → keys.

    Attributes:
        name: Path of the model.
        manifest: Manifest of the model.
        inputs: The inputs that a caller may set: neither the image nor those with a fixed value.
        animation: The timeline of its scene, with key frames by tensor name; None without.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
        SceneInvalid: The file is not a post-process model.
        UnknownName: The model has no input that has a value or key frames.
    """

    def __init__(
        self,
        path: Path,
        provider: str = "cpu",
        sizes: Mapping[str, int] | None = None,
        confined: "ConfinedModels | None" = None,
        values: Values | None = None,
        where: str = "values",
        animation: Animation | None = None,
    ) -> None:
        self.name = str(path)
        self._model_path, self._provider, self._sizes = path, provider, dict(sizes or {})
        self._confined_models = confined
        from gsgen.sdk.binding.bound.model_facts import read_model_facts

        facts = read_model_facts(path, None)
        self.manifest = _post_process_manifest(self.name, facts)
        image = named(self.manifest.inputs, "image")
        graph_inputs = {value.name for value in facts.file.proto.graph.input}
        if not image or image[0].name not in graph_inputs:
            message = "the model declares no image input, expected an input of role image"
            raise SceneInvalid(message, where=self.name)
        self._image = image[0].name
        self._shapes = {spec.name: spec for spec in _tensor_specs(facts)}
        self._size_bindings = facts.sizes(self._sizes)
        self._axes = {
            axis: dimension or f"{self._image}[{axis + 2}]"
            for axis, dimension in enumerate(self._shapes[self._image].dims[2:])
            if not isinstance(dimension, int)
        }
        self._session_and_size: tuple[tuple[int, int], FrameSession] | None = None
        self.inputs: tuple[Input, ...] = tuple(
            spec for spec in self.manifest.inputs if spec.name != self._image
        )
        self._fixed_values, self.animation = fixed_and_keyed(self, values, animation, where)
        self.inputs = tuple(spec for spec in self.inputs if spec.name not in self._fixed_values)
        if not self._axes:
            self._open_session((0, 0))  # a model that cannot run raises before drawing begins

    @property
    def scale(self) -> int:
        """Height and width of the model's result, as multiples of those of a frame."""
        return self.manifest.outputs.image.scale

    def named(self, word: str) -> list[Input]:
        """Return the model inputs with this tensor name, or else with this input role."""
        return named(self.inputs, word)

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an input of the post-process model other than the image.

        Raises:
            SizeUnknown: The shape depends on the size of the image.
        """
        if self._session_and_size is not None:
            return self._session_and_size[1].inputs[name].shape
        return self._shapes[name].shape(self._size_bindings)

    def __call__(self, frame: Frame, values: Mapping[str, object] | None = None) -> Frame:
        """Run the model on a frame with colours, and return the frame with new colours.

        An enlarging model returns the colours and alpha of a larger frame, and no other outputs.
        ``values`` maps tensor names or roles to values; absent inputs keep theirs.

        Raises:
            SceneInvalid: The frame has no colours, or the model's output is not a valid image.
            GsgenError: A value does not fit, or the model fails.
        """
        if frame.rgba is None:
            raise SceneInvalid(
                "the post-process model reads colours, but the frame was drawn without colours",
                where=self.name,
            )
        alpha = np.clip(frame.rgba[..., 3:], 0, 1)
        height, width = alpha.shape[:2]
        session = self._open_session((height, width))
        session.update({**(values or {}), **self._fixed_values})
        binding = session.inputs[self._image]
        pixels = np.concatenate([_straight_alpha_srgb(frame, alpha), alpha], axis=-1)[
            ..., : binding.shape[1]
        ]
        low, high = self.manifest.image_range
        image = (low + (high - low) * pixels).transpose(2, 0, 1)[None].astype(binding.dtype)
        result = self._run_model(session, image)
        rgba = self._apply_alpha(result, alpha)
        color_space = self.manifest.outputs.image.color_space
        if self.scale == 1:
            return replace(frame, rgba=rgba, color_space=color_space)
        return Frame(
            rgba=rgba,
            alpha=rgba[..., 3],
            depth=None,
            median_depth=None,
            ids=None,
            normal=None,
            visible=frame.visible,
            pairs=frame.pairs,
            color_space=color_space,
        )

    def _run_model(
        self, session: "FrameSession", image: Float[np.ndarray, "1 c h w"]
    ) -> Float[np.ndarray, "1 c h w"]:
        output = self.manifest.outputs.image.name

        def network(part: Float[np.ndarray, "1 c h w"]) -> Float[np.ndarray, "1 c h w"]:
            return session.run({self._image: part})[output]

        height, width = session.inputs[self._image].shape[2:]
        if (height, width) != image.shape[2:]:
            overlap = min(TILE_OVERLAP, (min(height, width) - 1) // 2)
            return run_tiled(image, network, (height, width), overlap)
        return network(image)

    def _apply_alpha(
        self, result: Float[np.ndarray, "1 c h w"], alpha: Float32[np.ndarray, "h w 1"]
    ) -> Float32[np.ndarray, "h w 4"]:
        """Scale the model's output image to [0, 1], and multiply it by alpha."""
        height, width = (self.scale * side for side in alpha.shape[:2])
        if result.shape not in ((1, 3, height, width), (1, 4, height, width)):
            raise SceneInvalid(
                f"returned {list(result.shape)} for an image of {alpha.shape[0]} × "
                f"{alpha.shape[1]}, expected [1, 3 or 4, {height}, {width}]",
                where=self.name,
            )
        low, high = self.manifest.outputs.image.range
        image = (result[0].transpose(1, 2, 0).astype(np.float32) - low) / (high - low)
        is_finite = np.isfinite(image)
        if not is_finite.all():
            count = int(image.size - is_finite.sum())
            message = f"returned {count} non-finite values of {image.size}"
            raise SceneInvalid(message, where=self.name)
        if image.shape[2] == 4:
            alpha = np.clip(image[..., 3:], 0, 1)
        elif self.scale > 1:
            alpha = resample(alpha, (height, width))
        return np.concatenate([image[..., :3] * alpha, alpha], axis=-1, dtype=np.float32)

    def _open_session(self, size: tuple[int, int]) -> "FrameSession":
        """Return the ONNX Runtime session for an image of this height and width."""
        image_size = size if self._axes else (0, 0)
        if self._session_and_size is not None and self._session_and_size[0] == image_size:
            return self._session_and_size[1]
        self.close()
        sizes = self._sizes | {name: size[axis] for axis, name in self._axes.items()}
        from gsgen.sdk.binding import FrameSession

        session = FrameSession(
            self._model_path,
            provider=self._provider,
            sizes=sizes,
            confined=self._confined_models or False,
        )
        self._session_and_size = image_size, session
        return session

    def close(self) -> None:
        """Release the model's session; the next frame opens another."""
        if self._session_and_size is not None:
            self._session_and_size[1].close()
            self._session_and_size = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def open_posts(
    scene: SceneFile,
    provider: str = "cpu",
    sizes: Mapping[Path, Mapping[str, int]] | None = None,
    confined: "ConfinedModels | None" = None,
) -> list[PostProcessor]:
    """Open the post-process models of a scene file, in order; the caller closes them.

    Args:
        scene: The scene file.
        provider: ONNX Runtime's execution provider.
        sizes: Path of a model → symbol → size of an open dimension.
        confined: Runs models in a child process with limits; None runs them in this process.

    Raises:
        GsgenError: A model cannot be opened; the message names its location in the scene file.
    """
    with ExitStack() as exit_stack:
        models: list[PostProcessor] = []
        for post in scene.posts:
            open_model = partial(
                PostProcessor,
                post.path,
                provider,
                (sizes or {}).get(post.path),
                confined,
                values=post.inputs,
                where=f"{post.where}.inputs",
                animation=None if scene.span is None else Animation(scene.span, post.keys),
            )
            models.append(locate_errors(open_model, f"{post.where}.path"))
            exit_stack.callback(models[-1].close)
        exit_stack.pop_all()  # from here on the caller closes the models
    return models


def _post_process_manifest(name: str, facts: "ModelFacts") -> PostProcessManifest:
    manifest = facts.manifest
    if isinstance(manifest, PostProcessManifest):
        return manifest
    kind = f"is a {manifest.kind}" if manifest else "has no manifest"
    hint = "`gsgen inspect --emit-manifest` derives a manifest from names and shapes."
    if manifest and manifest.kind == "gaussian-generator":
        hint = "Pass generators as scenes: they compute Gaussians."
    raise SceneInvalid(f"{kind}, expected a post-process model", where=name, hint=hint)


def _tensor_specs(facts: "ModelFacts") -> "Iterator[TensorSpec]":
    """Yield each input of a model's graph with its dimensions."""
    from gsgen.sdk.binding.bound.bound_session import TensorSpec

    for value in facts.file.proto.graph.input:
        tensor = value.type.tensor_type
        dims = tuple(
            dimension.dim_value if dimension.HasField("dim_value") else dimension.dim_param or None
            for dimension in tensor.shape.dim
        )
        yield TensorSpec(value.name, np.dtype(np.float32), dims)


def _straight_alpha_srgb(
    frame: Frame, alpha: Float32[np.ndarray, "h w 1"]
) -> Float32[np.ndarray, "h w 3"]:
    """Return the colours of a frame in sRGB, in [0, 1], with straight alpha."""
    assert frame.rgba is not None
    straight_colors = frame.rgba[..., :3] / np.where(alpha > 0, alpha, 1)
    color = np.clip(straight_colors, 0, 1)
    return np.asarray(srgb_of_linear(color) if frame.color_space == "linear" else color)

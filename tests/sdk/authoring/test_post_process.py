"""Post-process models: what authors may declare, and what is checked before a file is written."""

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
import torch

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import GeneratorInvalid, ParityFailed, PostProcess, export_post_process, inputs
from gsgen.sdk.plugins.factory import load_factory

STATIC = Settings(level=Level.STATIC)
VALUES = Settings(level=Level.VALUES)


class Darken(PostProcess):
    """A share of the image, and none of it beyond white."""

    def __init__(self, size: tuple[int, int] | None = None, share: float = 0.5) -> None:
        super().__init__()
        self.inputs = [inputs.image(3, size), inputs.timestep(10), inputs.conditioning(2, 3)]
        self.share = torch.nn.Parameter(torch.tensor(share))

    def forward(self, image: Any, timestep: Any, conditioning: Any) -> Any:
        """Darken it, and by a little more of all else."""
        more = timestep / 1e4 + conditioning.float().mean().reshape(1) / 1e2
        return (image * self.share + more.to(image.dtype).reshape(1, 1, 1, 1)).clamp(0, 1)


def test_a_model_of_open_size_takes_every_size(tmp_path: Path) -> None:
    actual = export_post_process(Darken(), tmp_path / "dark.onnx", settings=VALUES)
    assert actual.contents == "an image of any size, float32"
    assert actual.parity.holds
    session = onnxruntime.InferenceSession(actual.path)
    assert MANIFEST_KEY in session.get_modelmeta().custom_metadata_map
    remaining = {"timestep": np.zeros(1, np.float32), "conditioning": np.zeros((1, 2, 3), "f4")}
    for shape in ((1, 3, 1, 1), (1, 3, 30, 51)):
        image = np.random.default_rng(0).random(shape).astype(np.float32)
        (result,) = session.run(None, {"image": image, **remaining})
        np.testing.assert_allclose(result, image / 2, atol=1e-6)


def test_float16_applies_to_images_and_weights(tmp_path: Path) -> None:
    model = Darken((4, 6))
    result = export_post_process(model, tmp_path / "half.onnx", dtype="float16", settings=VALUES)
    types = {
        get_input.name: get_input.type
        for get_input in onnxruntime.InferenceSession(result.path).get_inputs()
    }
    assert types["image"] == "tensor(float16)"
    assert types["timestep"] == types["conditioning"] == "tensor(float)"
    assert result.manifest.outputs.image.dtype == "float16"
    assert model.share.dtype == torch.float32, "the author's module was changed"


def test_a_module_that_does_not_agree_with_itself_is_not_written(tmp_path: Path) -> None:
    class Moody(Darken):
        """Another image in the graph than in eager torch."""

        def forward(self, image: Any, timestep: Any, conditioning: Any) -> Any:
            outputs = super().forward(image, timestep, conditioning)
            return outputs if torch.compiler.is_exporting() else 0.9 * outputs

    path = tmp_path / "moody.onnx"
    with pytest.raises(ParityFailed, match="times the tolerance") as caught:
        export_post_process(Moody((4, 4)), path, settings=STATIC)
    assert caught.value.parity is not None
    assert not path.exists()
    assert not list(tmp_path.iterdir())


def test_alpha_may_come_along_whatever_the_size(tmp_path: Path) -> None:
    class Keep(PostProcess):
        """The image, alpha and all."""

        inputs = (inputs.image(4),)
        channels = 4

        def forward(self, image: Any) -> Any:
            return image * 0.5

    result = export_post_process(Keep(), tmp_path / "keep.onnx", settings=STATIC)
    shape = onnxruntime.InferenceSession(result.path).get_inputs()[0].shape
    assert shape[:2] == [1, 4]
    assert all(isinstance(side, str) for side in shape[2:])


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ([], "declares 0 image inputs, expected one"),
        ([inputs.image(), inputs.image(name="other")], "declares 2 image inputs, expected one"),
        ([inputs.image(), inputs.timestep(0, name="image")], "two inputs are named"),
        ([inputs.image(name="result")], "is the name of the result"),
        ([inputs.image(), inputs.view()], "the role view"),
        ([inputs.image(range=(-1.0, 1.0))], "image_range is"),
    ],
)
def test_invalid_declared_inputs_are_refused(declared: list, message: str, tmp_path: Path) -> None:
    model = Darken()
    model.inputs = declared
    with pytest.raises(GeneratorInvalid, match=message):
        export_post_process(model, tmp_path / "m.onnx")


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda image: image[:, :, ::2], r"\[1, 3, 2, 6\], expected \[1, 3 or 4, 4, 6\]"),
        (lambda image: image[:, :1], r"\[1, 1, 4, 6\]"),
        (lambda image: [image], "returned list"),
        (lambda image: image @ image, "forward raised RuntimeError"),
    ],
)
def test_output_of_another_size_is_refused(result: Any, message: str, tmp_path: Path) -> None:
    class Odd(PostProcess):
        """Something else."""

        inputs = (inputs.image(3, (4, 6)),)

        def forward(self, image: Any) -> Any:
            return result(image)

    with pytest.raises(GeneratorInvalid, match=message):
        export_post_process(Odd(), tmp_path / "m.onnx")


def test_factory_may_return_a_post_process_module(tmp_path: Path) -> None:
    source = (
        "from gsgen.sdk import PostProcess, inputs\n"
        "class Same(PostProcess):\n"
        "    inputs = (inputs.image(),)\n"
        "    def forward(self, image):\n"
        "        return image + 0\n"
    )
    (tmp_path / "post_of_mine.py").write_text(source)
    built = load_factory("post_of_mine:Same", tmp_path).build({})
    assert isinstance(built, PostProcess)
    with pytest.raises(UnknownName, match="Sane"):
        load_factory("post_of_mine:Sane", tmp_path)

"""Modules that torch and Python let through, and that cannot be exported: told at once, by name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import GaussianGenerator, Gaussians, PostProcess, export, export_post_process, inputs
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.plugins.factory import load_factory


class Cloud(GaussianGenerator):
    """Eight Gaussians in a line, as large as ``size``."""

    inputs = (inputs.time(),)

    def __init__(self, size: float = 0.1, opacity: float = 0.5) -> None:
        super().__init__()
        self.size, self.opacity = size, opacity

    def forward(self, time: torch.Tensor) -> Gaussians:
        line = torch.linspace(-1, 1, 8)[:, None] * torch.ones(1, 3)
        return Gaussians(
            position=line + time,
            opacity=torch.full((8,), self.opacity),
            scale=torch.full((8, 3), self.size),
            rotation=torch.tensor([[1.0, 0, 0, 0]]).repeat(8, 1),
            rgb=torch.full((8, 3), 0.5),
            count=torch.tensor([7], dtype=torch.int32),
        )


class NotSetUp(Cloud):
    def __init__(self) -> None:
        self.size = 0.1


class OneInput(Cloud):
    inputs = inputs.time()  # type: ignore[assignment]


class NamedInput(Cloud):
    inputs = ("time",)  # type: ignore[assignment]


class NamedInputs(Cloud):
    inputs = "time"  # type: ignore[assignment]


class TakesDiffusionTime(Cloud):
    inputs = (inputs.timestep(1.0),)


class TakesPicturesOfAnySize(Cloud):
    inputs = (inputs.image(),)


class FourDegrees(Cloud):
    def forward(self, time: torch.Tensor) -> Gaussians:
        return replace(super().forward(time), rgb=None, sh=torch.ones(8, 25, 3))


class Sepia(PostProcess):
    """A post-process model, which is no generator."""

    inputs = (inputs.image(),)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return image


@pytest.mark.parametrize(
    ("result", "where", "label", "hint"),
    [
        (NotSetUp, "NotSetUp", "__init__ does not call super().__init__()", "super().__init__()"),
        (
            OneInput,
            "OneInput.inputs",
            "the attribute is a single input, expected a tuple of inputs",
            "(inputs.time(),)",
        ),
        (
            NamedInput,
            "NamedInput.inputs[0]",
            "'time' is not an input",
            "gsgen.sdk.authoring.inputs",
        ),
        (
            NamedInputs,
            "NamedInputs.inputs",
            "the attribute is str, expected a tuple of inputs",
            "inputs.time()",
        ),
        (lambda: Cloud, "Cloud", "the generator is a class, expected an instance", "Cloud()"),
        (dict, "dict", "the object is not a torch module", "GaussianGenerator"),
        (
            TakesDiffusionTime,
            "TakesDiffusionTime.inputs",
            "input 'timestep' has the role timestep, which a gaussian-generator lacks",
            "such as condition",
        ),
        (
            TakesPicturesOfAnySize,
            "TakesPicturesOfAnySize.inputs",
            "input 'image' has no shape",
            "inputs.images(4, (256, 256))",
        ),
        (
            FourDegrees,
            "Gaussians.sh",
            "shape is [8, 25, 3], expected [8, 1, 3] or [8, 4, 3] or [8, 9, 3] or [8, 16, 3]",
            "gsgen.sdk.math.sh_of_degree(sh, 3)",
        ),
        (
            lambda: Cloud(-3.0),
            "Gaussians.scale",
            "the scale is negative in 7 of 7 rows, down to -3; expected standard deviations",
            "torch.exp",
        ),
        (
            lambda: Cloud(opacity=-4.0),
            "Gaussians.opacity",
            "the opacity is outside 0 to 1 in 7 of 7 rows, from -4 to -4; expected opacities",
            "torch.sigmoid",
        ),
    ],
)
def test_unexportable_module_is_refused(
    result: Any, where: str, label: str, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(GeneratorInvalid) as refused:
        export(result(), tmp_path / "model.onnx")
    assert (refused.value.where, refused.value.message) == (where, label)
    assert hint in refused.value.hint
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("export_module", "module", "expected", "hint"),
    [
        (export, torch.nn.Linear(3, 3), "GaussianGenerator", "gsgen.sdk.wrap(module, inputs="),
        (export, Sepia(), "GaussianGenerator", "gsgen.sdk.export_post_process"),
        (export_post_process, Cloud(), "PostProcess", "gsgen.sdk.export."),
        (export_post_process, torch.nn.Linear(3, 3), "PostProcess", "subclass of gsgen.sdk.Post"),
    ],
)
def test_a_module_of_another_kind_is_refused_with_what_exports_it(
    export_module: Any, module: torch.nn.Module, expected: str, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(GeneratorInvalid) as refused:
        export_module(module, tmp_path / "model.onnx")
    assert refused.value.where == type(module).__name__
    assert refused.value.message == f"the object is a torch module, expected a {expected}"
    assert hint in refused.value.hint


class Swapped(Cloud):
    inputs = (inputs.time(), inputs.camera_position())

    def forward(self, camera_position: torch.Tensor, time: torch.Tensor) -> Gaussians:
        return super().forward(camera_position @ torch.ones(3, 1) + time)


class Renamed(Swapped):
    def forward(self, eye: torch.Tensor, when: torch.Tensor) -> Gaussians:
        return super().forward(eye, when)


@pytest.mark.parametrize(
    ("module", "hint"),
    [
        (
            Swapped(),
            "Inputs are passed in the declared order: time, camera_position. "
            "forward takes them as camera_position, time.",
        ),
        (Renamed(), ""),  # other names say nothing about the order
    ],
)
def test_inputs_of_forward_in_another_order_are_named_if_it_raises(
    module: GaussianGenerator, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(GeneratorInvalid, match="forward raised RuntimeError") as refused:
        export(module, tmp_path / "model.onnx")
    assert refused.value.hint == hint


class Misnamed(Cloud):
    def forward(self, time: torch.Tensor) -> Gaussians:
        return Gaussians(shs=torch.zeros(8, 1, 3))  # type: ignore[call-arg]


class Unheard(Cloud):
    def forward(self, time: torch.Tensor) -> Gaussians:
        return super().forward(self.tyme)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("module", "hint"),
    [
        (
            Misnamed(),
            "Did you mean 'sh'? Gaussians takes position, opacity, scale, rotation, covariance, "
            "sh, rgb, count, cells.",
        ),
        (Unheard(), ""),  # names of torch's own would mislead
    ],
)
def test_a_misspelled_name_in_forward_gets_the_known_ones(
    module: GaussianGenerator, hint: str, tmp_path: Path
) -> None:
    with pytest.raises(GeneratorInvalid, match="forward raised") as refused:
        export(module, tmp_path / "model.onnx")
    assert refused.value.hint == hint


def test_a_misspelled_input_gets_the_known_name(tmp_path: Path) -> None:
    (tmp_path / "misspelled.py").write_text(
        "from gsgen.sdk import inputs\nDECLARED = (inputs.camera_pos(),)\n"
    )
    with pytest.raises(GsgenError, match="has no attribute 'camera_pos'") as refused:
        load_factory("misspelled:Mine", tmp_path)
    assert refused.value.hint == "Did you mean 'camera_position'?"


def test_offsets_may_make_single_scales_negative(tmp_path: Path) -> None:
    class Offset(Cloud):
        def forward(self, time: torch.Tensor) -> Gaussians:
            outputs = super().forward(time)
            assert outputs.scale is not None
            return replace(
                outputs, scale=outputs.scale * torch.tensor([1.0] * 5 + [-1.0] * 3)[:, None]
            )

    static = Settings(level=Level.STATIC)
    assert export(Offset(), tmp_path / "model.onnx", settings=static).parity.holds


def test_factory_result_is_checked(tmp_path: Path) -> None:
    (tmp_path / "unready.py").write_text(
        "from gsgen.sdk import GaussianGenerator\n"
        "class Mine(GaussianGenerator):\n"
        "    def __init__(self): self.size = 1\n"
        "    def forward(self): return None\n"
    )
    factory = load_factory("unready:Mine", tmp_path)
    with pytest.raises(GeneratorInvalid, match="does not call super"):
        factory.build({})


@pytest.mark.parametrize("name", ["open mouth", "smile\t"])
def test_a_name_with_a_blank_is_refused_before_the_trace(name: str, tmp_path: Path) -> None:
    class Smiling(GaussianGenerator):
        inputs = (inputs.control(name, range=(0, 1), default=0.0),)

        def forward(self, smile: torch.Tensor) -> Gaussians:
            raise AssertionError("forward ran")

    with pytest.raises(GeneratorInvalid, match="has a blank or a control character") as caught:
        export(Smiling(), tmp_path / "m.onnx")
    assert "Write " in caught.value.hint

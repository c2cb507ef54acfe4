from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest
import torch

from gsgen.contract.errors import UnknownName
from gsgen.sdk import Gaussians, GeneratorInvalid, export, inputs, wrap

N = 12


class Plain(torch.nn.Module):
    """A module as it may exist: it knows nothing of gsgen."""

    def __init__(self, give: Any = dict) -> None:
        super().__init__()
        self.give = give
        self.velocity = torch.nn.Parameter(torch.linspace(-1, 1, 3 * N).reshape(N, 3))

    def forward(self, time: torch.Tensor, bright: torch.Tensor) -> Any:
        xyz = self.velocity * (1 + time)
        return self.give(
            xyz=xyz,
            logits=torch.zeros(N, 1) + 0 * time,
            log_scales=torch.full((N, 3), -3.0),
            quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(N, 1),
            colors=bright.expand(N, 3),
        )


INPUTS = [inputs.time(), inputs.control("bright", range=(0, 1), default=0.5)]
OUTPUT_MAPPING = {
    "position": "xyz",
    "opacity": lambda made: torch.sigmoid(made["logits"]),
    "scale": lambda made: made["log_scales"].exp(),
    "rotation": "quats",
    "rgb": "colors",
}
Row = namedtuple("Row", "xyz logits log_scales quats colors")


def first(generator: Any) -> Gaussians:
    with torch.no_grad():
        result = generator(torch.full((1,), 0.5), torch.full((1,), 0.25))
    assert isinstance(result, Gaussians)
    return result


def check(result: Gaussians, module: Plain) -> None:
    assert torch.equal(result.position, 1.5 * module.velocity)
    assert torch.equal(result.opacity, torch.full((N, 1), 0.5))
    assert result.scale is not None
    torch.testing.assert_close(result.scale, torch.full((N, 3), -3.0).exp())
    assert result.rgb is not None
    assert (result.rgb == 0.25).all()


def test_a_module_that_returns_a_dict_is_wrapped_and_exported(tmp_path: Path) -> None:
    module = Plain()
    generator = wrap(module, inputs=INPUTS, outputs=OUTPUT_MAPPING, family="4d")
    check(first(generator), module)
    exported = export(generator, tmp_path / "m.onnx")
    assert exported.parity.holds
    assert exported.manifest.family == "4d"
    assert [entry.role for entry in exported.manifest.inputs] == ["time", "control"]


def test_attributes_and_positions_are_found() -> None:
    by_attribute = OUTPUT_MAPPING | {
        "opacity": lambda result: torch.sigmoid(result.logits),
        "scale": lambda result: result.log_scales.exp(),
    }
    module = Plain(Row)
    check(first(wrap(module, inputs=INPUTS, outputs=by_attribute)), module)
    by_position = {
        "position": 0,
        "opacity": lambda result: torch.sigmoid(result[1]),
        "scale": lambda result: result[2].exp(),
        "rotation": 3,
        "rgb": -1,
    }
    module = Plain(lambda **parts: tuple(parts.values()))
    check(first(wrap(module, inputs=INPUTS, outputs=by_position)), module)


def test_inputs_are_passed_by_name_where_asked() -> None:
    module = Plain()
    swapped = wrap(module, inputs=INPUTS[::-1], outputs=OUTPUT_MAPPING, by_name=True)
    with torch.no_grad():
        result = swapped(torch.full((1,), 0.25), torch.full((1,), 0.5))
    check(result, module)


def test_wrapped_modules_do_not_share_declarations() -> None:
    a = wrap(Plain(), inputs=INPUTS, outputs=OUTPUT_MAPPING, depends_on={"time": True})
    b = wrap(Plain(), inputs=INPUTS[:1], outputs=OUTPUT_MAPPING)
    assert (len(a.inputs), len(b.inputs)) == (2, 1)
    assert (a.depends_on, b.depends_on) == ({"time": True}, {})


@pytest.mark.parametrize(
    ("outputs", "error", "words"),
    [
        ({"positions": "xyz", "opacity": "a"}, UnknownName, "Did you mean 'position'?"),
        ({"opacity": "a"}, GeneratorInvalid, "'position' is missing"),
        (
            OUTPUT_MAPPING | {"position": "means"},
            GeneratorInvalid,
            "Plain returns a dict of 'xyz', 'logits', 'log_scales', 'quats', 'colors', "
            "which has no 'means'",
        ),
        (OUTPUT_MAPPING | {"position": 0}, GeneratorInvalid, "outputs['position'] = 0"),
        (OUTPUT_MAPPING | {"rgb": lambda result: 3}, GeneratorInvalid, "is int, expected a tensor"),
    ],
)
def test_a_field_that_is_not_there_is_named(
    outputs: dict[str, Any], error: type[Exception], words: str
) -> None:
    with pytest.raises(error) as caught:
        first(wrap(Plain(), inputs=INPUTS, outputs=outputs))
    assert words in str(caught.value)


def test_a_position_beyond_a_tuple_is_named() -> None:
    module = Plain(lambda **parts: tuple(parts.values()))
    with pytest.raises(GeneratorInvalid, match="returns 5 values, which has no 7"):
        first(wrap(module, inputs=INPUTS, outputs=OUTPUT_MAPPING | {"position": 7}))

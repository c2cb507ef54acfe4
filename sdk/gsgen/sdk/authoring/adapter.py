"""Wraps an existing torch module as a generator of Gaussians, without changing the module.

For example, for a module that takes a view matrix and a time and returns a dict::

    generator = wrap(
        network,
        inputs=[inputs.view(), inputs.time()],
        outputs={"position": "xyz", "opacity": "alpha", "covariance": "cov", "rgb": "color"},
    )
"""

__all__ = ["OutputSelector", "wrap"]

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from torch import Tensor, nn

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.manifest import Input, Producer, Space, WeightedSum
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.errors import GeneratorInvalid

# The source of a field: a key, an attribute or a position in the module's result, or a function
# of the whole result.
OutputSelector = str | int | Callable[[Any], Any]

_FIELD_NAMES = tuple(field.name for field in dataclasses.fields(Gaussians))


def wrap(
    module: nn.Module,
    *,
    inputs: Sequence[Input],
    outputs: Mapping[str, OutputSelector],
    by_name: bool = False,
    space: Space | None = None,
    color_space: Literal["srgb", "linear"] = "srgb",
    antialias: Literal["classic", "mip"] = "classic",
    depends_on: Mapping[str, bool] | None = None,
    family: str | None = None,
    producer: Producer | None = None,
    weighted_sum: WeightedSum | None = None,
) -> GaussianGenerator:
    """Return a generator of Gaussians that runs the torch module ``module``.

    Args:
        module: Anything that returns a dict, a tuple, an object with attributes or one tensor.
        inputs: Its inputs in order, from the functions of :mod:`gsgen.sdk.authoring.inputs`.
        outputs: Field of :class:`Gaussians` → its source in the module's result: a key or
            attribute, a position, or a function such as ``lambda out: out["log_scale"].exp()``.
            The source of ``cells`` is a :class:`gsgen.sdk.Cells`.
        by_name: Pass the inputs by their names instead of in order.
        space: Coordinate frame and matrix memory order.
        color_space: Colour space of the colours from SH or RGB.
        antialias: How the model was trained: ``classic`` (0.3 px dilation) or ``mip``.
        depends_on: Role → whether outputs change with it; roles not named do.
        family: ``static``, ``mlp``, ``4d``, ``avatar`` or another word.
        producer: Tool, source and licence.
        weighted_sum: The weights of Gaussians, for methods that sum them cell by cell.

    Raises:
        UnknownName: ``outputs`` names a field that :class:`Gaussians` does not have.
        GeneratorInvalid: ``outputs`` lacks ``position`` or ``opacity``.
    """
    for name in outputs:
        if name not in _FIELD_NAMES:
            raise UnknownName.among("field", name, _FIELD_NAMES, "wrap, outputs")
    for name in ("position", "opacity"):
        if name not in outputs:
            message = f"{name!r} is missing, expected a source for it"
            raise GeneratorInvalid(message, where="wrap, outputs")
    generator = _WrappedGenerator(module, outputs, by_name=by_name)
    generator.inputs = tuple(inputs)
    generator.depends_on = dict(depends_on or {})  # type: ignore[misc]
    generator.space = space or Space()
    generator.color_space, generator.antialias = color_space, antialias
    generator.family, generator.producer, generator.weighted_sum = (family, producer, weighted_sum)
    return generator


class _WrappedGenerator(GaussianGenerator):
    """A Gaussian generator that runs a user's torch module and picks Gaussians from its result."""

    def __init__(
        self, module: nn.Module, outputs: Mapping[str, OutputSelector], *, by_name: bool
    ) -> None:
        super().__init__()
        self.module = module
        self.outputs = dict(outputs)
        self.by_name = by_name

    def forward(self, *inputs: Tensor) -> Gaussians:
        """Run the wrapped torch module, and pick the fields of Gaussians from its result."""
        if self.by_name:
            names = [entry.name for entry in self.inputs]
            result = self.module(**dict(zip(names, inputs, strict=True)))
        else:
            result = self.module(*inputs)
        selected = {
            name: self._select_tensor(result, name, selector)
            for name, selector in self.outputs.items()
        }
        return Gaussians(**selected)

    def _select_tensor(self, result: Any, field: str, selector: OutputSelector) -> Any:
        value = self._extract_field(result, field, selector)
        if isinstance(value, Cells if field == "cells" else Tensor):
            return value
        expected = "gsgen.sdk.Cells" if field == "cells" else "a tensor"
        message = f"is {type(value).__name__}, expected {expected}"
        raise GeneratorInvalid(message, where=self._location(field, selector))

    def _extract_field(self, result: Any, field: str, selector: OutputSelector) -> Any:
        if callable(selector):
            return selector(result)
        if isinstance(result, Tensor):
            result = (result,)
        if isinstance(selector, str) and not isinstance(result, Mapping):
            if hasattr(result, selector):
                return getattr(result, selector)
        elif isinstance(result, Mapping | Sequence):
            try:
                return result[selector]  # type: ignore[index]
            except (LookupError, TypeError):
                pass
        kind = type(self.module).__name__
        message = f"{kind} returns {_describe_model_result(result)}, which has no {selector!r}"
        raise GeneratorInvalid(message, where=self._location(field, selector))

    @staticmethod
    def _location(field: str, selector: OutputSelector) -> str:
        source = (
            getattr(selector, "__name__", "a function") if callable(selector) else repr(selector)
        )
        return f"wrap, outputs[{field!r}] = {source}"


def _describe_model_result(result: Any) -> str:
    """Describe the result of a user's torch module for an error message: type, shape, keys."""
    if isinstance(result, Mapping):
        return f"a dict of {', '.join(repr(key) for key in result)}"
    if isinstance(result, Sequence):
        return f"{len(result)} values"
    return type(result).__name__

"""Wrap a module that exists already, without a change to it.

Such as, for a module that takes a view matrix and a time and returns a dict::

    generator = wrap(
        network,
        inputs=[inputs.view(), inputs.time()],
        outputs={"position": "xyz", "opacity": "alpha", "covariance": "cov", "rgb": "color"},
    )
"""

__all__ = ["Take", "wrap"]

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from torch import Tensor, nn

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.manifest import Input, Producer, Space, WeightedSum
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.errors import GeneratorInvalid

# Where a field comes from: a key, an attribute or a position in what the module returns, or a
# function of all of it.
Take = str | int | Callable[[Any], Any]

_FIELDS = tuple(field.name for field in dataclasses.fields(Gaussians))


def wrap(
    module: nn.Module,
    *,
    inputs: Sequence[Input],
    outputs: Mapping[str, Take],
    by_name: bool = False,
    space: Space | None = None,
    color_space: Literal["srgb", "linear"] = "srgb",
    antialias: Literal["classic", "mip"] = "classic",
    depends_on: Mapping[str, bool] | None = None,
    family: str | None = None,
    producer: Producer | None = None,
    weighted_sum: WeightedSum | None = None,
) -> GaussianGenerator:
    """Make a generator of ``module``.

    Args:
        module: Anything that returns a dict, a tuple, an object with attributes or one tensor.
        inputs: What it takes, in order, made by the functions of :mod:`gsgen.sdk.authoring.inputs`.
        outputs: Field of :class:`Gaussians` → where it is in what the module returns: a key or
            attribute, a position, or a function such as ``lambda out: out["log_scale"].exp()``.
            For ``cells`` that is a :class:`gsgen.sdk.Cells`.
        by_name: Pass the inputs by their names instead of in order.
        space: Coordinate frame and matrix memory order.
        color_space: Of the colours that come out of SH or RGB.
        antialias: How the model was trained: ``classic`` (0.3 px dilation) or ``mip``.
        depends_on: Role → whether outputs change with it; roles not named do.
        family: ``static``, ``mlp``, ``4d``, ``avatar`` or another word.
        producer: Tool, source and licence.
        weighted_sum: How Gaussians are weighed, where they are summed cell by cell.

    Raises:
        UnknownName: ``outputs`` names a field that Gaussians do not have.
        GeneratorInvalid: ``position`` or ``opacity`` is not among them.
    """
    for name in outputs:
        if name not in _FIELDS:
            raise UnknownName.among("field", name, _FIELDS, "wrap, outputs")
    for name in ("position", "opacity"):
        if name not in outputs:
            what = f"{name!r} is not said, and every Gaussian has one"
            raise GeneratorInvalid(what, where="wrap, outputs")
    made = _Wrapped(module, outputs, by_name)
    made.inputs = tuple(inputs)
    made.depends_on = dict(depends_on or {})  # type: ignore[misc]
    made.space = space or Space()
    made.color_space, made.antialias = color_space, antialias
    made.family, made.producer, made.weighted_sum = family, producer, weighted_sum
    return made


class _Wrapped(GaussianGenerator):
    """A module, and where to find Gaussians in what it returns."""

    def __init__(
        self, module: nn.Module, outputs: Mapping[str, Take], by_name: bool
    ) -> None:
        super().__init__()
        self.module = module
        self.outputs = dict(outputs)
        self.by_name = by_name

    def forward(self, *inputs: Tensor) -> Gaussians:
        """Run the module and pick the fields."""
        if self.by_name:
            names = [entry.name for entry in self.inputs]
            made = self.module(**dict(zip(names, inputs, strict=True)))
        else:
            made = self.module(*inputs)
        picked = {name: self._pick(made, name, take) for name, take in self.outputs.items()}
        return Gaussians(**picked)

    def _pick(self, made: Any, field: str, take: Take) -> Any:
        value = self._found(made, field, take)
        if isinstance(value, Cells if field == "cells" else Tensor):
            return value
        wanted = "gsgen.sdk.Cells" if field == "cells" else "a tensor"
        what = f"is {type(value).__name__}, wanted {wanted}"
        raise GeneratorInvalid(what, where=self._place(field, take))

    def _found(self, made: Any, field: str, take: Take) -> Any:
        if callable(take):
            return take(made)
        if isinstance(made, Tensor):
            made = (made,)
        if isinstance(take, str) and not isinstance(made, Mapping):
            if hasattr(made, take):
                return getattr(made, take)
        elif isinstance(made, Mapping | Sequence):
            try:
                return made[take]  # type: ignore[index]
            except (LookupError, TypeError):
                pass
        kind = type(self.module).__name__
        what = f"{kind} returns {_described(made)}, which has no {take!r}"
        raise GeneratorInvalid(what, where=self._place(field, take))

    @staticmethod
    def _place(field: str, take: Take) -> str:
        shown = getattr(take, "__name__", "a function") if callable(take) else repr(take)
        return f"wrap, outputs[{field!r}] = {shown}"


def _described(made: Any) -> str:
    """Return what a module returned, for people."""
    if isinstance(made, Mapping):
        return f"a dict of {', '.join(repr(key) for key in made)}"
    if isinstance(made, Sequence):
        return f"{len(made)} values"
    return type(made).__name__

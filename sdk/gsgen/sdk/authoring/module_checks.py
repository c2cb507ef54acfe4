"""Checks a user's torch module before it is run, for mistakes that Python does not report."""

__all__ = ["validate_module"]

from typing import Any

from torch import nn

from gsgen.contract.spec.manifest import Input
from gsgen.sdk.errors import GeneratorInvalid

_INPUTS_HINT = (
    "Make inputs with the functions of gsgen.sdk.authoring.inputs, such as inputs.time()."
)


def validate_module(module: Any) -> None:
    """Raise if an object to export is not an initialised torch module with declared inputs.

    Finds classes in place of instances, ``__init__`` without the parent's, and ``inputs`` that are
    not a sequence of inputs.
    """
    if isinstance(module, type):
        name = module.__name__
        raise GeneratorInvalid(
            "the generator is a class, expected an instance", where=name, hint=f"{name}()"
        )
    name = type(module).__name__
    if not isinstance(module, nn.Module):
        hint = "Return an instance of a subclass of gsgen.sdk.GaussianGenerator."
        raise GeneratorInvalid("the object is not a torch module", where=name, hint=hint)
    if "_modules" not in vars(module):
        hint = "Begin it with super().__init__()."
        raise GeneratorInvalid("__init__ does not call super().__init__()", where=name, hint=hint)
    _require_inputs(getattr(module, "inputs", ()), f"{name}.inputs")


def _require_inputs(declared: Any, where: str) -> None:
    if isinstance(declared, Input):
        hint = "A tuple of one has a comma: inputs = (inputs.time(),)"
        raise GeneratorInvalid(
            "the attribute is a single input, expected a tuple of inputs", where=where, hint=hint
        )
    if isinstance(declared, str) or not isinstance(declared, tuple | list):
        message = f"the attribute is {type(declared).__name__}, expected a tuple of inputs"
        raise GeneratorInvalid(message, where=where, hint=_INPUTS_HINT)
    for index, entry in enumerate(declared):
        if not isinstance(entry, Input):
            message = f"{entry!r} is not an input"
            raise GeneratorInvalid(message, where=f"{where}[{index}]", hint=_INPUTS_HINT)

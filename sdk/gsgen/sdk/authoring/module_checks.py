"""What a module has to be and to declare before it is run: mistakes that Python lets through."""

__all__ = ["validate_module"]

from typing import Any

from torch import nn

from gsgen.contract.spec.manifest import Input
from gsgen.sdk.errors import GeneratorInvalid

_MADE = (
    "Make inputs with the functions of gsgen.sdk.authoring.inputs, such as inputs.time()."
)


def validate_module(module: Any) -> None:
    """Refuse what is no module, one that was not set up, and inputs that are none.

    Args:
        module: What was given to be exported, a generator or a post-process model.

    Raises:
        GeneratorInvalid: It is a class, or nothing of torch; its ``__init__`` forgot that of its
            parent; or ``inputs`` is not a sequence of inputs.
    """
    if isinstance(module, type):
        name = module.__name__
        raise GeneratorInvalid("is a class, wanted a module", where=name, hint=f"{name}()")
    name = type(module).__name__
    if not isinstance(module, nn.Module):
        hint = "Return an instance of a subclass of gsgen.sdk.GaussianGenerator."
        raise GeneratorInvalid("is no torch module", where=name, hint=hint)
    if "_modules" not in vars(module):
        hint = "Begin it with super().__init__()."
        raise GeneratorInvalid("__init__ does not call its parent's", where=name, hint=hint)
    _require_inputs(getattr(module, "inputs", ()), f"{name}.inputs")


def _require_inputs(declared: Any, where: str) -> None:
    if isinstance(declared, Input):
        hint = "A tuple of one has a comma: inputs = (inputs.time(),)"
        raise GeneratorInvalid("is one input, wanted a tuple", where=where, hint=hint)
    if isinstance(declared, str) or not isinstance(declared, tuple | list):
        what = f"is {type(declared).__name__}, wanted a tuple of inputs"
        raise GeneratorInvalid(what, where=where, hint=_MADE)
    for place, entry in enumerate(declared):
        if not isinstance(entry, Input):
            what = f"{entry!r} is no input"
            raise GeneratorInvalid(what, where=f"{where}[{place}]", hint=_MADE)

"""Checks a user's torch module before it is run, for mistakes that Python does not report."""

__all__ = ["WRAP_CALL", "input_order_hint", "validate_module"]

import inspect
from collections.abc import Sequence
from typing import Any

from torch import nn

from gsgen.contract._safe_text import is_plain_name
from gsgen.contract.spec.fields.roles import GENERATOR, POST_PROCESS, ROLES
from gsgen.contract.spec.manifest import Input
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.post_process import PostProcess
from gsgen.sdk.errors import GeneratorInvalid

_INPUTS_HINT = (
    "Make inputs with the functions of gsgen.sdk.authoring.inputs, such as inputs.time()."
)
# What makes a Gaussian generator of another torch module, for hints.
WRAP_CALL = (
    "gsgen.sdk.wrap(module, inputs=[inputs.time()], outputs={'position': 0, 'opacity': 1, …})"
)


def validate_module(module: Any, kind: type[GaussianGenerator] | type[PostProcess]) -> None:
    """Raise if an object to export is not an initialised torch module with declared inputs.

    Finds classes in place of instances, torch modules of another kind, ``__init__`` without the
    parent's, and ``inputs`` that are not a sequence of inputs with names of their own and shapes.

    Args:
        module: The object.
        kind: What the export takes: Gaussian generators or post-process models.
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
    if not isinstance(module, kind):
        message = f"the object is a torch module, expected a {kind.__name__}"
        raise GeneratorInvalid(message, where=name, hint=_kind_hint(module, kind))
    if "_modules" not in vars(module):
        hint = "Begin it with super().__init__()."
        raise GeneratorInvalid("__init__ does not call super().__init__()", where=name, hint=hint)
    declared = getattr(module, "inputs", ())
    _require_inputs(declared, f"{name}.inputs")
    _require_names_and_shapes(declared, kind, f"{name}.inputs")


def _kind_hint(module: nn.Module, kind: type[nn.Module]) -> str:
    """Return how a torch module of another kind can be exported."""
    if isinstance(module, PostProcess):
        return "Export it with gsgen.sdk.export_post_process."
    if isinstance(module, GaussianGenerator):
        return "Export it with gsgen.sdk.export."
    if kind is GaussianGenerator:
        return f"Export {WRAP_CALL}."
    return "Call it from the forward of a subclass of gsgen.sdk.PostProcess."


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


def _require_names_and_shapes(declared: Sequence[Input], kind: type[nn.Module], where: str) -> None:
    names = [entry.name for entry in declared]
    model_kind = POST_PROCESS if kind is PostProcess else GENERATOR
    for entry in declared:
        if entry.role in ROLES and model_kind not in ROLES[entry.role].kinds:
            message = f"input {entry.name!r} has the role {entry.role}, which a {model_kind} lacks"
            hint = "Declare what it holds with another function of gsgen.sdk.inputs, such as condition."
            raise GeneratorInvalid(message, where=where, hint=hint)
        if not is_plain_name(entry.name):
            hint = f"Write {''.join(c if c.isalnum() else '_' for c in entry.name)!r}; label= has the text of a slider."
            message = f"the name {entry.name!r} of an input has a blank or a control character"
            raise GeneratorInvalid(message, where=where, hint=hint)
        if names.count(entry.name) > 1:
            hint = "Give each input a name of its own."
            raise GeneratorInvalid(f"two inputs are named {entry.name!r}", where=where, hint=hint)
        is_image = kind is PostProcess and entry.role == "image"
        if entry.shape is None and not is_image:
            hint = "Make inputs with the functions of gsgen.sdk.inputs."
            if entry.role == "image":
                hint = "A generator takes pictures of one size: inputs.images(4, (256, 256))."
            raise GeneratorInvalid(f"input {entry.name!r} has no shape", where=where, hint=hint)


def input_order_hint(module: nn.Module) -> str:
    """Return a hint if ``forward`` names the declared inputs in another order; else nothing."""
    declared = [entry.name for entry in getattr(module, "inputs", ())]
    parameters = list(inspect.signature(module.forward).parameters)
    if parameters == declared or sorted(parameters) != sorted(declared):
        return ""
    return (
        f"Inputs are passed in the declared order: {', '.join(declared)}. forward takes them as "
        f"{', '.join(parameters)}."
    )

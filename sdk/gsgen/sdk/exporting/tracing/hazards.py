"""Watches a torch module run, and records operations that tracing cannot follow.

Tracing records torch functions. A value of an input that leaves torch (a Python number, a numpy
array, a branch) is either refused, or keeps its value of the traced frame. The same holds for
attributes that forward sets for later frames, and for random numbers.

A hazard alone does not make an export wrong, so it is reported only if another check fails.
"""

__all__ = ["Hazard", "HazardKind", "HazardWatch", "describe_hazard"]

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import TracebackType
from typing import Any, Literal, Self

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

from gsgen.sdk.exporting.tracing.source_lines import current_user_line

HazardKind = Literal[
    "branch", "changing", "data", "linalg", "number", "numpy", "order", "random", "rebuilt", "shape",
    "state", "training",
]  # fmt: skip

_DESCRIPTIONS_AND_HINTS: dict[HazardKind, tuple[str, str]] = {
    "branch": (
        "Python branches on a tensor",
        "torch.where(condition, a, b) chooses in every frame; an assert belongs into __init__ or a test.",
    ),
    "changing": (
        "a value of Python or numpy changes from run to run",
        "Random numbers, clocks and files are read once, in __init__; a time comes as an input.",
    ),
    "data": ("`.data` hides a tensor from tracing", "Use the tensor itself, or .detach()."),
    "linalg": (
        "ONNX has no operator for this matrix function",
        "gsgen.sdk.math.inverse_3x3 inverts matrices, gsgen.sdk.math.camera_centre takes the centre "
        "out of a view matrix; compute the others once, in __init__.",
    ),
    "number": (
        "an input's value becomes a Python number",
        "Keep it a tensor: torch has the arithmetic, torch.where chooses, tensor indices gather.",
    ),
    "numpy": ("an input's value goes through numpy", "Use the torch function of the same name."),
    "order": (
        "rows are selected or ordered by values that may be equal",
        "Where values tie, add a small number of each row to them, such as 1e-6 * row index.",
    ),
    "random": (
        "random numbers are drawn in forward",
        "Draw them once, in __init__, and keep them with register_buffer.",
    ),
    "rebuilt": (
        "a new tensor is made from the values of an input",
        "torch.stack and torch.cat join tensors without copying their values out.",
    ),
    "shape": (
        "a shape depends on the values of an input",
        "Multiply by the mask or use torch.where; gsgen.sdk.math.keep_rows moves rows forward.",
    ),
    "state": (
        "forward changes the module",
        "Compute it in every frame from the inputs, or once, in __init__.",
    ),
    "training": (
        "a layer is in training mode, in which its result depends on chance or on the other rows",
        "Call .eval() on the layer, or give training=False to the function.",
    ),
}

_LINALG_NAMES = (
    *("inv", "inv_ex", "pinv", "solve", "solve_ex", "lstsq", "det", "slogdet", "svd", "svdvals"),
    *("eig", "eigh", "eigvals", "eigvalsh", "qr", "cholesky", "lu", "matrix_exp", "matrix_power"),
)
_KIND_OF_FUNCTION: dict[str, HazardKind] = {
    **dict.fromkeys(("__bool__", "is_nonzero", "__contains__", "equal", "allclose"), "branch"),
    **dict.fromkeys(("item", "tolist", "__float__", "__int__", "__index__"), "number"),
    **dict.fromkeys(("numpy", "__array__"), "numpy"),
    **dict.fromkeys(("tensor", "as_tensor", "asarray"), "rebuilt"),
    **dict.fromkeys(("nonzero", "argwhere", "masked_select", "unique"), "shape"),
    **dict.fromkeys(("argsort", "sort", "topk", "msort"), "order"),
    **dict.fromkeys(("inverse", "pinverse", "det", "logdet", "svd", "qr", "cholesky"), "linalg"),
    **dict.fromkeys((f"linalg_{name}" for name in _LINALG_NAMES), "linalg"),
}
_RANDOM_FUNCTIONS = frozenset(
    {
        *("rand", "randn", "randint", "randperm", "normal", "bernoulli", "multinomial"),
        *("rand_like", "randn_like", "randint_like", "uniform_", "normal_", "random_"),
    }
)
_INPUT_MARK = "_gsgen_of_an_input"


def describe_hazard(kind: HazardKind) -> tuple[str, str]:
    """Return what a kind of operation does that tracing cannot follow, and what to write instead."""
    return _DESCRIPTIONS_AND_HINTS[kind]


@dataclass(frozen=True, slots=True)
class Hazard:
    """An operation of a user's module that tracing cannot follow."""

    kind: HazardKind  # the kind of operation
    where: str  # ``file:line (code)``; where an attribute is set, its name stands in front

    @property
    def description(self) -> str:
        """A short description of the operation that tracing cannot follow."""
        return describe_hazard(self.kind)[0]

    @property
    def hint(self) -> str:
        """The code to write instead of an operation that tracing cannot follow."""
        return describe_hazard(self.kind)[1]

    def __str__(self) -> str:
        return f"{self.where}: {self.description}. {self.hint}"


class HazardWatch(TorchFunctionMode):
    """Records operations that tracing cannot follow while a torch module runs.

    For example::

        with Watch(module, tensors) as watch:
            module(*tensors)
        watch.hazards

    Attributes:
        hazards: The hazards, in order, each line once.
    """

    def __init__(self, module: nn.Module, inputs: list[Tensor]) -> None:
        super().__init__()
        self.hazards: list[Hazard] = []
        self._module = module
        self._module_tensors = {
            id(tensor): tensor for tensor in (*module.parameters(), *module.buffers())
        }
        self._modules = {id(part) for part in module.modules()}  # not those that forward makes
        self._undo_steps: list[Callable[[], None]] = []
        self._saved_attribute_keys: set[tuple[int, str]] = set()
        for tensor in inputs:
            setattr(tensor, _INPUT_MARK, True)

    def __enter__(self) -> Self:
        self._original_module_setattr: Any = nn.Module.__setattr__
        setattr(nn.Module, "__setattr__", self._setattr())  # noqa: B010
        super().__enter__()  # type: ignore[no-untyped-call]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        super().__exit__(kind, error, trace)  # type: ignore[no-untyped-call]
        setattr(nn.Module, "__setattr__", self._original_module_setattr)  # noqa: B010

    @property
    def changes_module(self) -> bool:
        """Whether the torch module changed its attributes, parameters or buffers while it ran."""
        return bool(self._undo_steps)

    def restore_module(self) -> None:
        """Restore all attributes and buffers of the torch module to their values before the run."""
        for step in reversed(self._undo_steps):
            step()

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Call a torch function, and record if tracing cannot follow the operation."""
        kwargs = kwargs or {}
        name = getattr(func, "__name__", "")
        leaves = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        depends_on_input = any(hasattr(leaf, _INPUT_MARK) for leaf in leaves)
        self._inspect_call(func, name, args, kwargs, depends_on_input=depends_on_input)
        result = func(*args, **kwargs)
        if depends_on_input:
            changed_tensors = [args[0]] if name == "__setitem__" else []
            for leaf in (*tree_leaves(result), *changed_tensors):
                if isinstance(leaf, Tensor):
                    setattr(leaf, _INPUT_MARK, True)
        return result

    def _inspect_call(
        self, func: Any, name: str, args: Any, kwargs: Any, *, depends_on_input: bool
    ) -> None:
        if name in _RANDOM_FUNCTIONS:
            self._record_hazard("random")
        # Signatures mean nothing to Dynamo, which follows this function in compiled modules.
        if not torch.compiler.is_dynamo_compiling() and _is_training(func, args, kwargs):
            self._record_hazard("training")
        if _is_in_place_operator(name) and args and id(args[0]) in self._module_tensors:
            self._record_hazard("state")
            self._save_tensor(args[0])
        if not depends_on_input:
            return
        if name in _KIND_OF_FUNCTION:
            self._record_hazard(_KIND_OF_FUNCTION[name])
        elif getattr(func, "__self__", None) is torch.Tensor.data:
            self._record_hazard("data")
        elif (name == "__getitem__" and _is_mask(args[1])) or (name == "where" and len(args) == 1):
            self._record_hazard("shape")

    def _record_hazard(self, kind: HazardKind, prefix: str = "") -> None:
        line = current_user_line()
        is_known = [
            hazard for hazard in self.hazards if hazard.kind == kind and line in hazard.where
        ]
        if line and not is_known:
            self.hazards.append(Hazard(kind, f"{prefix}{line}"))

    def _save_tensor(self, tensor: Tensor) -> None:
        if (id(tensor), "") not in self._saved_attribute_keys:
            self._saved_attribute_keys.add((id(tensor), ""))
            old_value = tensor.detach().clone()
            self._undo_steps.append(lambda: _restore_tensor(tensor, old_value))

    def _setattr(self) -> Callable[[nn.Module, str, Any], None]:
        original_setattr: Callable[[nn.Module, str, Any], None] = self._original_module_setattr

        def record_and_set(module: nn.Module, name: str, value: Any) -> None:
            if id(module) not in self._modules:
                original_setattr(module, name, value)
                return
            is_unchanged = module.__dict__.get(name, module) is value
            if not is_unchanged:
                kind: HazardKind = "training" if name == "training" and value else "state"
                self._record_hazard(kind, f"{type(module).__name__}.{name}, ")
            if (id(module), name) not in self._saved_attribute_keys:
                self._saved_attribute_keys.add((id(module), name))
                is_known_attribute = name in module.__dict__
                old_value = module.__dict__.get(name)
                if name in module._buffers:
                    buffer = module._buffers[name]
                    self._undo_steps.append(lambda: module._buffers.update({name: buffer}))
                elif is_known_attribute:
                    self._undo_steps.append(lambda: module.__dict__.update({name: old_value}))
                else:
                    self._undo_steps.append(lambda: module.__dict__.pop(name, None))
            original_setattr(module, name, value)

        return record_and_set


def _is_in_place_operator(name: str) -> bool:
    ends_in_underscore = name.endswith("_") and not name.endswith("__")
    is_operator = name.startswith("__i") and name not in ("__index__", "__int__", "__invert__")
    return ends_in_underscore or is_operator or name == "__setitem__"


def _is_training(func: Any, args: Any, kwargs: Any) -> bool:
    """Return whether a function is told to train, as dropout and norms are; not if it drops nothing."""
    defaults = _defaults_of(func)
    values = defaults | dict(zip(defaults, args, strict=False)) | kwargs
    drops_nothing = values.get("p", values.get("dropout_p")) == 0
    return not drops_nothing and any(values.get(name) is True for name in ("training", "train"))


@cache
def _defaults_of(func: Any) -> dict[str, Any]:
    """Return the parameters of a torch function with their defaults; none if it has no training mode."""
    try:
        parameters = inspect.signature(func).parameters.values()
        defaults = {parameter.name: parameter.default for parameter in parameters}
    except (TypeError, ValueError):  # a builtin; its schema has the names
        packet = getattr(torch.ops.aten, getattr(func, "__name__", ""), None)
        overload = getattr(packet, "default", None)
        arguments = overload._schema.arguments if overload is not None else ()
        defaults = {argument.name: argument.default_value for argument in arguments}
    return defaults if {"training", "train"} & set(defaults) else {}


def _is_mask(index: Any) -> bool:
    parts = index if isinstance(index, tuple) else (index,)
    return any(isinstance(part, Tensor) and part.dtype == torch.bool for part in parts)


def _restore_tensor(tensor: Tensor, old_value: Tensor) -> None:
    with torch.no_grad():
        tensor.copy_(old_value)

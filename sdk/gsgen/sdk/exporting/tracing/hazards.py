"""Watches a torch module run, and records operations that tracing cannot follow.

Tracing records torch functions. A value of an input that leaves torch (a Python number, a numpy
array, a branch) is either refused, or keeps its value of the traced frame. The same holds for
attributes that forward sets for later frames, and for random numbers.

A hazard alone does not make an export wrong, so it is reported only if another check fails.
"""

__all__ = ["Hazard", "Watch", "hint_of"]

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

from gsgen.sdk.exporting.tracing.source_lines import current_user_line

Kind = Literal[
    "branch", "data", "linalg", "number", "numpy", "order", "random", "rebuilt", "shape", "state"
]  # fmt: skip

_DESCRIPTIONS_AND_HINTS: dict[Kind, tuple[str, str]] = {
    "branch": (
        "Python branches on a tensor",
        "torch.where(condition, a, b) chooses in every frame.",
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
}

_LINALG = (
    *("inv", "inv_ex", "pinv", "solve", "solve_ex", "lstsq", "det", "slogdet", "svd", "svdvals"),
    *("eig", "eigh", "eigvals", "eigvalsh", "qr", "cholesky", "lu", "matrix_exp", "matrix_power"),
)
_NAMES: dict[str, Kind] = {
    **dict.fromkeys(("__bool__", "is_nonzero", "__contains__", "equal", "allclose"), "branch"),
    **dict.fromkeys(("item", "tolist", "__float__", "__int__", "__index__"), "number"),
    **dict.fromkeys(("numpy", "__array__"), "numpy"),
    **dict.fromkeys(("tensor", "as_tensor", "asarray"), "rebuilt"),
    **dict.fromkeys(("nonzero", "argwhere", "masked_select", "unique"), "shape"),
    **dict.fromkeys(("argsort", "sort", "topk", "msort"), "order"),
    **dict.fromkeys(("inverse", "pinverse", "det", "logdet", "svd", "qr", "cholesky"), "linalg"),
    **dict.fromkeys((f"linalg_{name}" for name in _LINALG), "linalg"),
}
_RANDOM = frozenset(
    {
        *("rand", "randn", "randint", "randperm", "normal", "bernoulli", "multinomial"),
        *("rand_like", "randn_like", "randint_like", "uniform_", "normal_", "random_"),
    }
)
_TAINT = "_gsgen_of_an_input"


def hint_of(kind: Kind) -> str:
    """Return the code to write instead of a kind of operation that tracing cannot follow."""
    return _DESCRIPTIONS_AND_HINTS[kind][1]


@dataclass(frozen=True, slots=True)
class Hazard:
    """An operation of a user's module that tracing cannot follow."""

    kind: Kind  # the kind of operation
    where: str  # ``file:line (code)``; where an attribute is set, its name stands in front

    @property
    def description(self) -> str:
        """A short description of the operation that tracing cannot follow."""
        return _DESCRIPTIONS_AND_HINTS[self.kind][0]

    @property
    def hint(self) -> str:
        """The code to write instead of an operation that tracing cannot follow."""
        return hint_of(self.kind)

    def __str__(self) -> str:
        return f"{self.where}: {self.description}. {self.hint}"


class Watch(TorchFunctionMode):
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
        self._owned = {id(tensor): tensor for tensor in (*module.parameters(), *module.buffers())}
        self._undo: list[Callable[[], None]] = []
        self._saved: set[tuple[int, str]] = set()
        for tensor in inputs:
            setattr(tensor, _TAINT, True)

    def __enter__(self) -> Self:
        self._plain_setattr: Any = nn.Module.__setattr__
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
        setattr(nn.Module, "__setattr__", self._plain_setattr)  # noqa: B010

    @property
    def changes_module(self) -> bool:
        """Whether the torch module changed its attributes, parameters or buffers while it ran."""
        return bool(self._undo)

    def undo(self) -> None:
        """Restore all attributes and buffers of the torch module to their values before the run."""
        for step in reversed(self._undo):
            step()

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Call a torch function, and record if tracing cannot follow the operation."""
        kwargs = kwargs or {}
        name = getattr(func, "__name__", "")
        leaves = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        tainted = any(hasattr(leaf, _TAINT) for leaf in leaves)
        self._inspect(func, name, args, tainted=tainted)
        result = func(*args, **kwargs)
        if tainted:
            changed = [args[0]] if name == "__setitem__" else []
            for leaf in (*tree_leaves(result), *changed):
                if isinstance(leaf, Tensor):
                    setattr(leaf, _TAINT, True)
        return result

    def _inspect(self, func: Any, name: str, args: Any, *, tainted: bool) -> None:
        if name in _RANDOM:
            self._note("random")
        if self._is_in_place(name) and args and id(args[0]) in self._owned:
            self._note("state")
            self._keep_tensor(args[0])
        if not tainted:
            return
        if name in _NAMES:
            self._note(_NAMES[name])
        elif getattr(func, "__self__", None) is torch.Tensor.data:
            self._note("data")
        elif (name == "__getitem__" and _is_mask(args[1])) or (name == "where" and len(args) == 1):
            self._note("shape")

    @staticmethod
    def _is_in_place(name: str) -> bool:
        ends_in_underscore = name.endswith("_") and not name.endswith("__")
        is_operator = name.startswith("__i") and name not in ("__index__", "__int__", "__invert__")
        return ends_in_underscore or is_operator or name == "__setitem__"

    def _note(self, kind: Kind, prefix: str = "") -> None:
        line = current_user_line()
        known = [hazard for hazard in self.hazards if hazard.kind == kind and line in hazard.where]
        if line and not known:
            self.hazards.append(Hazard(kind, f"{prefix}{line}"))

    def _keep_tensor(self, tensor: Tensor) -> None:
        if (id(tensor), "") not in self._saved:
            self._saved.add((id(tensor), ""))
            before = tensor.detach().clone()
            self._undo.append(lambda: _copy(tensor, before))

    def _setattr(self) -> Callable[[nn.Module, str, Any], None]:
        original_setattr: Callable[[nn.Module, str, Any], None] = self._plain_setattr

        def note(module: nn.Module, name: str, value: Any) -> None:
            self._note("state", f"{type(module).__name__}.{name}, ")
            if (id(module), name) not in self._saved:
                self._saved.add((id(module), name))
                known = name in module.__dict__
                before = module.__dict__.get(name)
                if name in module._buffers:
                    buffer = module._buffers[name]
                    self._undo.append(lambda: module._buffers.update({name: buffer}))
                elif known:
                    self._undo.append(lambda: module.__dict__.update({name: before}))
                else:
                    self._undo.append(lambda: module.__dict__.pop(name, None))
            original_setattr(module, name, value)

        return note


def _is_mask(index: Any) -> bool:
    parts = index if isinstance(index, tuple) else (index,)
    return any(isinstance(part, Tensor) and part.dtype == torch.bool for part in parts)


def _copy(tensor: Tensor, before: Tensor) -> None:
    with torch.no_grad():
        tensor.copy_(before)

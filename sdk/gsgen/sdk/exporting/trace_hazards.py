"""Watch a module run, and note what tracing cannot follow: each with its line, and a cure.

Tracing records torch functions. A value of an input that leaves torch (a Python number, a numpy
array, a branch) is either refused, or stays what it was in the traced frame. So are attributes
that forward sets for the frames to come, and random numbers.

None of this alone makes an export wrong, so a hazard is told only where something else fails.
"""

__all__ = ["Hazard", "Watch"]

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

from gsgen.sdk.exporting.source_lines import line_here

Kind = Literal["branch", "data", "number", "numpy", "random", "rebuilt", "shape", "state"]

_CURES: dict[Kind, tuple[str, str]] = {
    "branch": (
        "Python branches on a tensor",
        "torch.where(condition, a, b) chooses anew in every frame.",
    ),
    "data": (
        "`.data` cuts a tensor off from what is traced",
        "Use the tensor itself, or .detach().",
    ),
    "number": (
        "an input's value becomes a Python number",
        "Keep it a tensor: torch has the arithmetic, torch.where chooses, tensor indices gather.",
    ),
    "numpy": (
        "an input's value goes through numpy",
        "Use the torch function of the same name.",
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

_NAMES: dict[str, Kind] = {
    **dict.fromkeys(
        ("__bool__", "is_nonzero", "__contains__", "equal", "allclose"), "branch"
    ),
    **dict.fromkeys(("item", "tolist", "__float__", "__int__", "__index__"), "number"),
    **dict.fromkeys(("numpy", "__array__"), "numpy"),
    **dict.fromkeys(("tensor", "as_tensor", "asarray"), "rebuilt"),
    **dict.fromkeys(("nonzero", "argwhere", "masked_select", "unique"), "shape"),
}
_RANDOM = frozenset(
    {
        *("rand", "randn", "randint", "randperm", "normal", "bernoulli", "multinomial"),
        *("rand_like", "randn_like", "randint_like", "uniform_", "normal_", "random_"),
    }
)
_TAINT = "_gsgen_of_an_input"


@dataclass(frozen=True, slots=True)
class Hazard:
    """Something that tracing cannot follow.

    Attributes:
        kind: What sort of thing.
        where: ``file:line (code)``; the attribute's name stands in front where one is set.
    """

    kind: Kind
    where: str

    @property
    def what(self) -> str:
        """What happens there, in a few words."""
        return _CURES[self.kind][0]

    @property
    def hint(self) -> str:
        """What to write instead."""
        return _CURES[self.kind][1]

    def __str__(self) -> str:
        return f"{self.where}: {self.what}. {self.hint}"


class Watch(TorchFunctionMode):
    """Note hazards while a module runs.

    Such as::

        with Watch(module, tensors) as watch:
            module(*tensors)
        watch.hazards

    Attributes:
        hazards: What was seen, in order, each line once.
    """

    def __init__(self, module: nn.Module, inputs: list[Tensor]) -> None:
        super().__init__()
        self.hazards: list[Hazard] = []
        self._module = module
        self._owned = {id(one): one for one in (*module.parameters(), *module.buffers())}
        self._undo: list[Callable[[], None]] = []
        self._saved: set[tuple[int, str]] = set()
        for one in inputs:
            setattr(one, _TAINT, True)

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
        """Whether the run changed an attribute, a parameter or a buffer."""
        return bool(self._undo)

    def undo(self) -> None:
        """Put back every attribute and buffer as it was before the run."""
        for step in reversed(self._undo):
            step()

    def __torch_function__(
        self, func: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        """Call ``func``, note what it is, and follow what it makes of inputs."""
        kwargs = kwargs or {}
        name = getattr(func, "__name__", "")
        leaves = [one for one in tree_leaves((args, kwargs)) if isinstance(one, Tensor)]
        tainted = any(hasattr(one, _TAINT) for one in leaves)
        self._inspect(func, name, args, tainted)
        made = func(*args, **kwargs)
        if tainted:
            changed = [args[0]] if name == "__setitem__" else []
            for one in (*tree_leaves(made), *changed):
                if isinstance(one, Tensor):
                    setattr(one, _TAINT, True)
        return made

    def _inspect(self, func: Any, name: str, args: Any, tainted: bool) -> None:
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
        elif (name == "__getitem__" and _is_mask(args[1])) or (
            name == "where" and len(args) == 1
        ):
            self._note("shape")

    @staticmethod
    def _is_in_place(name: str) -> bool:
        own = name.endswith("_") and not name.endswith("__")
        special = name.startswith("__i") and name not in (
            "__index__",
            "__int__",
            "__invert__",
        )
        return own or special or name == "__setitem__"

    def _note(self, kind: Kind, prefix: str = "") -> None:
        line = line_here()
        known = [one for one in self.hazards if one.kind == kind and line in one.where]
        if line and not known:
            self.hazards.append(Hazard(kind, f"{prefix}{line}"))

    def _keep_tensor(self, tensor: Tensor) -> None:
        if (id(tensor), "") not in self._saved:
            self._saved.add((id(tensor), ""))
            before = tensor.detach().clone()
            self._undo.append(lambda: _copy(tensor, before))

    def _setattr(self) -> Callable[[nn.Module, str, Any], None]:
        plain: Callable[[nn.Module, str, Any], None] = self._plain_setattr

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
                    self._undo.append(lambda: _forget(module, name))
            plain(module, name, value)

        return note


def _is_mask(index: Any) -> bool:
    parts = index if isinstance(index, tuple) else (index,)
    return any(isinstance(one, Tensor) and one.dtype == torch.bool for one in parts)


def _copy(tensor: Tensor, before: Tensor) -> None:
    with torch.no_grad():
        tensor.copy_(before)


def _forget(module: nn.Module, name: str) -> None:
    module.__dict__.pop(name, None)

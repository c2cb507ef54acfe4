"""Watches the operators of torch that a module runs: which line calls each, and in which precision.

Operators are watched where torch dispatches them, as the exporter sees them: ``torch.median`` and
``Tensor.median`` are one.
"""

__all__ = ["OperatorWatch", "missing_operator", "missing_operator_hint"]

import re
import sys
from types import FrameType
from typing import Any, Final, Self

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from gsgen.sdk.exporting.tracing.source_lines import current_user_line

_FLOAT32_BYTES: Final = 4
_CONVERSION_OPERATORS: Final = frozenset(
    {"_to_copy", "clone", "detach", "alias", "lift_fresh", "t", "view"}
)
_MISSING_OPERATOR_PATTERN: Final = re.compile(
    r"OpOverload\(op='\w+\.(\w+)'.*?Failure message: (.*)", re.DOTALL
)
_TRANSLATION_ERROR_PATTERN: Final = re.compile(
    r"Error when translating node .*?target=torch\.ops\.\w+\.(\w+)"
)

# What to write in place of an operator without ONNX form, by a pattern of its name.
_SUBSTITUTE_HINTS: Final[tuple[tuple[str, str], ...]] = (
    (
        "cummax|cummin|logcumsumexp",
        "With few rows, torch.where(mask, x[None], -torch.inf).amax(1) with a lower triangular "
        "mask is a running maximum.",
    ),
    ("median|nanmedian|kthvalue|mode|quantile", "torch.topk and torch.sort order values."),
    ("histc|histogram.*|bincount", "(x[:, None] == bins).float().sum(0) counts values per bin."),
    ("unique.*|nonzero.*", "Shapes must not depend on data: use masks of a fixed size."),
    (
        "fft.*|stft|istft|complex|view_as_.*|polar",
        "Write real and imaginary parts as two tensors; a Fourier transform of fixed size is a "
        "matrix product.",
    ),
    (
        ".*bessel.*|.*gamma.*|erf_?inv|ndtri|special_.*|i0|i1|zeta",
        "Use a polynomial or a table that is computed once, in __init__.",
    ),
    (
        "linalg_.*|cholesky.*|lu_.*|triangular_solve|geqrf|ormqr|inverse|logdet|.*_ex",
        "gsgen.sdk.math.inverse_3x3 inverts matrices; compute others once, in __init__.",
    ),
    (
        "grid_sampler.*|affine_grid.*",
        "gsgen.sdk.math samples planes and grids; others are sums of indexed corners.",
    ),
    ("multinomial|bernoulli|.*rand.*|normal.*|poisson", "Draw random numbers once, in __init__."),
)
_GENERAL_HINT: Final = (
    "Write it with operators that ONNX has (arithmetic, indexing, sums, products, torch.where, "
    "torch.topk), or compute it once, in __init__."
)


class OperatorWatch(TorchDispatchMode):
    """Records the operators that run, with the user's lines that called them.

    Attributes:
        lines: Operator, without namespace and overload → ``file:line (code)`` of its first call.
        low_precision: Line and dtype of the first operator that computes in a floating type below
            float32, or else converts to one; else empty.
        reading_line: The line of the first operator that reads ``watched``; empty without one.
    """

    def __init__(self, watched: Tensor | None = None) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.watched, self.reading_line = watched, ""
        self.lines: dict[str, str] = {}
        self.low_precision: tuple[str, str] | tuple[()] = ()
        self._is_computed = False
        self._caller_frame: FrameType | None = None

    def __enter__(self) -> Self:
        """Begin to watch; frames of the caller are not the module's."""
        self._caller_frame = sys._getframe(1)
        return super().__enter__()  # type: ignore[no-untyped-call, no-any-return]

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operator, and record it."""
        result = func(*args, **(kwargs or {}))
        name = func.overloadpacket.__name__
        line = current_user_line(self._caller_frame)
        self.lines.setdefault(name, line)
        if line and not self.reading_line and any(value is self.watched for value in args):
            self.reading_line = line
        if not self._is_computed:
            dtypes = [leaf.dtype for leaf in tree_leaves(result) if isinstance(leaf, Tensor)]
            low = [dtype for dtype in dtypes if _is_low_precision(dtype)]
            does_compute = name not in _CONVERSION_OPERATORS
            if low and line and (does_compute or not self.low_precision):
                self.low_precision = line, str(low[0]).removeprefix("torch.")
                self._is_computed = does_compute
        return result

    def line_of(self, operator: str) -> str:
        """Return the line that called an operator; empty if the module did not call it.

        Names are compared without prefix and underscores: the exporter decomposes
        ``special_bessel_j0`` to ``bessel_j0``, and ``erfinv`` to ``erf_inv``. Of others, one name ends
        with the other, as ``i0`` and ``bessel_i0``, or ``mvlgamma`` and ``lgamma``.
        """
        name = _plain_name(operator)
        lines = {_plain_name(call): line for call, line in reversed(self.lines.items())}
        if name in lines:
            return lines[name]
        calls = (call for call in lines if name.endswith(call) or call.endswith(name))
        return next((lines[call] for call in calls), "")

    @property
    def precision_hint(self) -> str:
        """What to write in place of arithmetic below float32; empty without such arithmetic."""
        if not self.low_precision:
            return ""
        line, dtype = self.low_precision
        return (
            f"{line}: computes in {dtype}, which runtimes round in another way, or have no kernels "
            "for. Call .float() on the module, or on its weights and inputs."
        )


def _is_low_precision(dtype: torch.dtype) -> bool:
    return dtype.is_floating_point and dtype.itemsize < _FLOAT32_BYTES


def _plain_name(operator: str) -> str:
    name = operator.removeprefix("special_").replace("_", "")
    return "gcd" if name == "lcm" else name  # lcm is decomposed to gcd


def missing_operator(error: BaseException) -> tuple[str, str]:
    """Return the operator that torch's exporter cannot write in ONNX, and a sentence on it.

    Both are empty if the exporter failed for another reason.
    """
    operator = ""
    cause: BaseException | None = error
    while cause is not None:
        if type(cause).__name__ == "DispatchError" and (
            match := _MISSING_OPERATOR_PATTERN.search(str(cause))
        ):
            kind = " of complex numbers" if "complex" in match[2] else ""
            return match[1], f"ONNX has no operator for torch.{match[1].strip('_')}{kind}"
        if match := _TRANSLATION_ERROR_PATTERN.search(str(cause)):
            operator = match[1]
        reason, cause = " ".join(str(cause).split())[:200], cause.__cause__
    if not operator:
        return "", ""
    return operator, f"torch cannot write torch.{operator.strip('_')} in ONNX ({reason})"


def missing_operator_hint(name: str, sentence: str) -> str:
    """Return what to write in place of an operator of :func:`missing_operator`."""
    if sentence.endswith("complex numbers"):
        return "Write real and imaginary parts as two tensors."
    plain_name = name.strip("_")
    for pattern, hint in _SUBSTITUTE_HINTS:
        if re.fullmatch(pattern, plain_name) or re.fullmatch(pattern, name):
            return f"{hint} {_GENERAL_HINT}"
    return _GENERAL_HINT

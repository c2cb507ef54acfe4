"""The registry of manifest extensions, and the operator profiles that models declare."""

__all__ = [
    "READER_PROFILES",
    "REGISTERED_EXTENSIONS",
    "Extension",
    "OperatorProfile",
    "smallest_profile",
]

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Extension:
    """A registered extension of the manifest.

    Attributes:
        name: The field that holds its data, such as ``x-studio-relight``.
        owner: Who maintains its specification.
        page: Where its specification is published.
    """

    name: str
    owner: str
    page: str


# None is registered yet. An entry is added as docs/spec/extensions.md says.
REGISTERED_EXTENSIONS: dict[str, Extension] = {}


@dataclass(frozen=True, slots=True)
class OperatorProfile:
    """A named set of ONNX operators and operator set versions that a runtime supports.

    Attributes:
        name: What ``operator_profile`` says.
        opset: Lowest and highest operator set.
        operators: Names of the operators.
        summary: One sentence for people.
    """

    name: str
    opset: tuple[int, int]
    operators: frozenset[str]
    summary: str

    def missing(self, operators: Iterable[str]) -> list[str]:
        """Return the given operators that the operator profile does not contain, sorted."""
        return sorted(set(operators) - self.operators)

    def holds(self, operators: Iterable[str], opset: int) -> bool:
        """Return whether the operator profile contains the given operators and operator set."""
        return self.opset[0] <= opset <= self.opset[1] and not self.missing(operators)


_PORTABLE_OPERATORS = """
Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh AveragePool BatchNormalization Cast
CastLike Ceil Clip Concat Constant Conv ConvTranspose Cos Cosh CumSum DepthToSpace
DequantizeLinear Div Einsum Elu Equal Erf Exp Expand Flatten Floor Gather GatherElements
GatherND Gemm GlobalAveragePool Greater GreaterOrEqual HardSigmoid HardSwish Identity
InstanceNormalization LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax
LpNormalization MatMul Max MaxPool Min Mul Neg Not PRelu Pad Pow Reciprocal ReduceL1 ReduceL2
ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu
Reshape Resize ScatterElements ScatterND Shape Sigmoid Sin Sinh Slice Softmax Softplus Split
Sqrt Squeeze Sub Tan Tanh ThresholdedRelu Tile TopK Transpose Trilu Unsqueeze Where
"""

READER_PROFILES = {
    profile.name: profile
    for profile in (
        OperatorProfile(
            "portable-1",
            (13, 20),
            frozenset(_PORTABLE_OPERATORS.split()),
            "What ONNX Runtime's WebGPU providers capture in float32; no control flow.",
        ),
    )
}


def smallest_profile(operators: Iterable[str], opset: int) -> str | None:
    """Return the name of the first operator profile that covers a graph's operators, or None."""
    names = set(operators)
    return next((p.name for p in READER_PROFILES.values() if p.holds(names, opset)), None)

"""Facts of the ONNX standard that rules, rewrites and runtimes share: dtypes, operators."""

__all__ = [
    "CONTROL_FLOW",
    "FLOAT_TYPES",
    "INLINE_LIMIT",
    "KERNEL_TYPE_INPUT",
    "MAIN_DOMAIN",
    "RANDOM_OPERATORS",
    "SAFEST_OPSET",
]

from typing import Final

# The two spellings of the domain of ONNX's own operators.
MAIN_DOMAIN: Final = ("", "ai.onnx")

# Operators whose attributes hold graphs.
CONTROL_FLOW: Final = frozenset({"If", "Loop", "Scan"})

# Operators that draw random numbers; Dropout only does so in training.
RANDOM_OPERATORS: Final = frozenset(
    {
        "Bernoulli",
        "Multinomial",
        "RandomNormal",
        "RandomNormalLike",
        "RandomUniform",
        "RandomUniformLike",
    }
)

# The IEEE floating-point element types that kernels compute with.
_FLOAT, _FLOAT16, _DOUBLE = 1, 10, 11  # numbers of ONNX's TensorProto.DataType
FLOAT_TYPES: Final[tuple[int, ...]] = (_FLOAT, _FLOAT16, _DOUBLE)

# The input whose element type selects the kernel, where it is not the first one. Pow has a type of
# its own for exponents, and 64-bit ones have no kernel on GPUs.
KERNEL_TYPE_INPUT: Final = {"OneHot": 2, "Pow": 1, "Where": 1}

# Bytes of weights that a model file may hold itself: protobuf refuses 2 GiB and more.
INLINE_LIMIT: Final = 1_900_000_000

SAFEST_OPSET = 18
"""The operator set that most runtimes have kernels for; exports default to it."""

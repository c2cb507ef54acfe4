"""Gates: groups of rules that must pass before dependent rules can be checked."""

__all__ = [
    "APPEARANCE",
    "AT_MOMENTS",
    "CELL_RULES",
    "COLORED_ROW_RULES",
    "COUNTED_ROW_RULES",
    "DECLARATION_RULES",
    "FINITE_OUTPUTS",
    "MANIFEST_PARSED",
    "MODEL_RUNS",
    "NOT_RANDOM",
    "ORDERED_ROWS",
    "PACKED_ROWS",
    "REPRODUCIBLE",
    "RUNNABLE_MODEL_RULES",
    "VALID_ROWS",
    "WELL_FORMED",
]

from typing import Final

# The id of the rule that the model ran to the end; without it no value can be checked.
MODEL_RUNS: Final = "GV025"

# The id of the rule that the rules of single runs hold at named moments, too.
AT_MOMENTS: Final = "GB044"

# The manifest has a known version and follows its schema.
MANIFEST_PARSED: Final = ("GM002", "GM003")

# Every tensor that the manifest names exists in the graph.
DECLARATION_RULES: Final = (*MANIFEST_PARSED, "GM004")

# The graph has a supported operator set, standard operators, and passes onnx.checker.
WELL_FORMED: Final = ("GG001", "GG002", "GG019")

# The model can be loaded and fed, and cannot reach outside its folder or exceed its memory.
RUNNABLE_MODEL_RULES: Final = (
    *DECLARATION_RULES,
    *("GI001", "GI002", "GI003", "GI004", "GI005"),
    *("GG001", "GG002", "GG012", "GG019"),
    *("GS001", "GS002"),
)

# No value is drawn at random: what leaves its range would have that cause.
NOT_RANDOM: Final = ("GG025", "GG010")

# The model ran, and its Gaussians are packed rows in float32 or float16.
PACKED_ROWS: Final = (MODEL_RUNS, *NOT_RANDOM, "GO001", "GO002", "GO008")

# Packed rows whose columns hold the fields in the order of the layout.
ORDERED_ROWS: Final = (*PACKED_ROWS, "GO016")

# Ordered rows whose opacities and covariances are valid, so that statistics of them mean something.
VALID_ROWS: Final = (*ORDERED_ROWS, "GV003", "GV005", "GV006")

# Packed rows, and a count that lies between 0 and the capacity.
COUNTED_ROW_RULES: Final = (*PACKED_ROWS, "GO010", "GO011", "GV016")

# The model ran, and its appearance has known channels, one row for each Gaussian.
APPEARANCE: Final = (MODEL_RUNS, *NOT_RANDOM, "GO005", "GO006", "GO007", "GO008", "GM005")

# Packed rows with an appearance of known channels.
COLORED_ROW_RULES: Final = (
    *(MODEL_RUNS, *NOT_RANDOM, "GO001", "GO002"),
    *("GO005", "GO006", "GO007", "GO008"),
)

# Packed rows, and cells that hold all of them.
CELL_RULES: Final = (*PACKED_ROWS, "GO021")

# The model ran, and equal inputs give equal bits, also after other inputs were run.
REPRODUCIBLE: Final = (MODEL_RUNS, "GB001", "GB002")

# Every output is finite, also in padding and where all inputs are zero.
FINITE_OUTPUTS: Final = ("GV001", "GV002", "GI009", "GV055", "GV060")

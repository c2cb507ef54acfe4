"""Write the operator tables that targets ship from a measurement of ONNX Runtime's WebGPU providers.

Usage: ``python scripts/write_operator_tables.py MEASURED.json``. The measurement runs each operator
between two Mul nodes with graph capture on, and says for each runtime, operator, variant, dtype and
operator set the outcome. The tables keep what a graph can be asked: variants that a node
does not show are merged, and an operator set is named only where the outcome changes.
"""

import json
import sys
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "contract/gsgen/contract/targets_data/operators"

# What tells the measured runtimes apart, and what the tables call them.
RUNTIMES = {
    "ep-webgpu-0.4.0": "onnxruntime-ep-webgpu 0.4.0 (onnxruntime 1.31.1)",
    "onnxruntime-web-1.30.0": "onnxruntime-web 1.30.0",
    "onnxruntime-web-1.22.0": "onnxruntime-web 1.22.0 (JSEP)",
}
DTYPES = {
    "f32": "float32",
    "f16": "float16",
    "i32": "int32",
    "i64": "int64",
    "u8": "uint8",
    "bool": "bool",
}
# Measured variants that a graph shows, and that behave differently somewhere.
VARIANTS = {
    ("MatMul", "[4,4]x[4]"): "vector",
    ("Slice", "step -1 (flip)"): "backwards",
    ("GatherND", "idx i64 init"): "constant",
    ("GridSample", "5d linear"): "5d",
    ("Resize", "cubic/half_pixel x2"): "cubic",
    ("ScatterND", "red=add idx init"): "add",
    ("ScatterElements", "red=add idx init"): "add",
}
# Arguments that decide shapes: a rule of their own checks these for every kernel.
LEFT_OUT = {("Slice", "starts i64 runtime input")}
# Where variants that no graph tells apart disagree, the better one stands: no false alarm.
ORDER = ("capture", "stale", "wrong", "cpu", "run_error", "error", "control_flow")
_IMPLICIT = "Conv/implicit dilations"
UNKNOWN = ("no_reference", "illegal")


def variant_of(operator: str, variant: str) -> str:
    """Return the table's name for a measured variant; empty for the usual one."""
    if operator == "Cast" and variant.startswith("to "):
        return f"to {DTYPES[variant.removeprefix('to ')]}"
    if operator == "Conv":  # all were measured without the attribute
        return _IMPLICIT.partition("/")[2]
    return VARIANTS.get((operator, variant), "")


def steps(outcomes: dict[int, str]) -> dict[str, str]:
    """Keep the operator sets from which on an outcome holds."""
    by_step: dict[str, str] = {}
    last = ""
    for opset in sorted(outcomes):
        if outcomes[opset] != last:
            last = by_step[str(opset)] = outcomes[opset]
    return by_step


def compact(measured: dict) -> dict[str, dict[str, dict[str, str]]]:
    """Return operator → dtypes → operator set from which on → outcome."""
    merged: dict[tuple[str, str], dict[int, str]] = {}
    for operator, variants in measured.items():
        for variant, dtypes in variants.items():
            if (operator, variant) in LEFT_OUT:
                continue
            name = "/".join(filter(None, (operator, variant_of(operator, variant))))
            for dtype, outcomes in dtypes.items():
                by_opset = merged.setdefault((name, DTYPES[dtype]), {})
                for opset, outcome in outcomes.items():
                    if outcome not in UNKNOWN:
                        known = by_opset.get(int(opset), outcome)
                        by_opset[int(opset)] = min(known, outcome, key=ORDER.index)
    table: dict[str, dict[str, dict[str, str]]] = {}
    for (name, dtype), outcomes in merged.items():
        if outcomes:
            table.setdefault(name, {})[dtype] = steps(outcomes)
    implicit = table.get(_IMPLICIT, {})
    if all(set(outcomes.values()) == {"capture"} for outcomes in implicit.values()):
        table["Conv"] = table.pop(_IMPLICIT)  # no node of it was refused
    return {name: grouped(table[name]) for name in sorted(table)}


def grouped(dtypes: dict[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Join dtypes with the same outcomes, as ``float16 float32``."""
    groups: dict[str, list[str]] = {}
    for dtype, by_opset in dtypes.items():
        groups.setdefault(json.dumps(by_opset), []).append(dtype)
    return {" ".join(sorted(names)): json.loads(text) for text, names in groups.items()}


def main(source: Path) -> None:
    """Write one table for each runtime."""
    measured = json.loads(source.read_text("utf-8"))["runtimes"]
    FOLDER.mkdir(exist_ok=True)
    for name, label in RUNTIMES.items():
        release = next(key for key in measured if key.startswith(name))
        rows = compact(measured[release])
        lines = [f'    "{op}": {json.dumps(rows[op])}' for op in rows]
        head = f'{{\n  "runtime": "{label}",\n  "operators": {{\n'
        text = head + ",\n".join(lines) + "\n  }\n}\n"
        (FOLDER / f"{name}.json").write_text(text, "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""No test replaces a part of the packages that we build on, but to fake what a machine lacks."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.commands import ROOT

FOREIGN = {"onnx", "onnx_ir", "onnxruntime", "onnxscript", "torch", "wgpu"}
# Each fakes a device or a provider that the machines of the tests lack.
FAKES = {
    "tests/runtime/renderer/test_limits.py": ["wgpu.gpu.request_adapter_sync"],
    "tests/runtime/renderer/test_meshes.py": ["type(device.raw).create_render_pipeline"],
    "tests/sdk/binding/test_providers.py": [
        "onnxruntime.register_execution_provider_library",
        "onnxruntime.get_ep_devices",
        "onnxruntime.InferenceSession",
        "onnxruntime.InferenceSession",
        "onnxruntime.get_available_providers",
        "onnxruntime.InferenceSession",
        "onnxruntime.OrtValue.ortvalue_from_shape_and_type",
    ],
}
_PATCHING_CALLS = {"setattr", "delattr", "object", "patch", "multiple"}


def _foreign_names(tree: ast.AST) -> set[str]:
    """Return the names that a file imports from packages that are not ours."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            aliases = [
                (alias.asname or alias.name.partition(".")[0], alias.name) for alias in node.names
            ]
            names |= {name for name, module in aliases if module.partition(".")[0] in FOREIGN}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in FOREIGN:
            names |= {alias.asname or alias.name for alias in node.names}
    return names


def replaced(code: str) -> Iterator[str]:
    """Yield each part of a foreign package that a file of tests replaces."""
    tree = ast.parse(code)
    names = _foreign_names(tree)

    def is_foreign(owner: str) -> bool:
        root = re.split(r"\W", owner)[0]
        return root in names or re.fullmatch(r"type\(.*\braw\)", owner) is not None

    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, (ast.Attribute, ast.Name)):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            words = [ast.unparse(word) for word in node.args[:2]]
            if called not in _PATCHING_CALLS or not words:
                continue
            if isinstance(node.args[0], ast.Constant):
                path = str(node.args[0].value)
                if path.partition(".")[0] in FOREIGN:
                    yield path
            elif is_foreign(words[0]):
                yield f"{words[0]}.{''.join(words[1:]).strip(chr(39))}"
        elif isinstance(node, (ast.Assign, ast.AugAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Attribute) and is_foreign(ast.unparse(target.value)):
                    yield ast.unparse(target)


@pytest.mark.parametrize(
    ("code", "parts"),
    [
        ("import torch\npatch.setattr(torch.ops, 'add', f)", ["torch.ops.add"]),
        ("from wgpu.backends import GPU\nwith patch.object(GPU, 'x', f): pass", ["GPU.x"]),
        ("patch.setattr('onnxruntime.InferenceSession', f)", ["onnxruntime.InferenceSession"]),
        ("import onnx_ir as ir\nir.Model.clone = f", ["ir.Model.clone"]),
        ("patch.setattr(type(device.raw), 'create_buffer', f)", ["type(device.raw).create_buffer"]),
        ("from gsgen.sdk import torch\npatch.setattr(torch, 'x', f)", []),
        ("import torch\npatch.setattr(ours, 'x', torch.add)", []),
    ],
)
def test_a_replaced_part_is_found(code: str, parts: list[str]) -> None:
    assert list(replaced(code)) == parts


def test_third_party_attributes_are_patched_only_for_missing_hardware() -> None:
    results: dict[str, list[str]] = {}
    for path in sorted(Path(ROOT, "tests").rglob("*.py")):
        parts = list(replaced(path.read_text("utf-8")))
        if parts:
            results[path.relative_to(ROOT).as_posix()] = parts
    assert {name: sorted(parts) for name, parts in results.items()} == {
        name: sorted(parts) for name, parts in FAKES.items()
    }

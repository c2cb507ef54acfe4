"""Untrusted bytes are read by a few functions, the gates: nobody calls a library past them."""

import ast
import re
from collections.abc import Iterator
from importlib import import_module

import pytest

from support.commands import ROOT

PACKAGES = ("contract", "sdk", "runtime", "reference_plugins")
RAW_CALLS = {
    *("onnx.load", "onnx.load_model", "onnx_ir.load", "onnx.external_data_helper.*"),
    *("onnxruntime.InferenceSession",),
    *("numpy.load", "numpy.lib.format.*", "numpy.lib.npyio.*"),
    *("pickle.load", "pickle.loads", "pickle.Unpickler", "_pickle.*", "pickletools.dis"),
    *("cloudpickle.*", "dill.*", "joblib.*", "marshal.*", "shelve.*"),
    *("torch.load", "torch.jit.load", "torch.hub.*", "torch.package.*", "torch.export.load"),
    *("scipy.io.loadmat", "pandas.*", "h5py.*", "shutil.unpack_archive", "tarfile.*"),
    *("zipfile.*.extractall", "zipfile.*.extract", "yaml.load", "eval", "exec"),
}
_ANY_OWNER = {"extractall", "extract"}

_OWN_FILES = "reads what gsgen wrote, in a folder that it made for this run"
GATES: dict[tuple[str, str], str] = {
    **{
        ("contract/gsgen/contract/process/array_files.py", f"numpy.lib.format.{name}"): (
            "the gate to .npy and .npz: the declared size is checked before"
        )
        for name in ("read_array", "read_array_header_1_0", "read_array_header_2_0", "read_magic")
    },
    ("sdk/gsgen/sdk/rewriting/model_io.py", "onnx_ir.load"): (
        "the gate to graphs that are changed: require_loadable is called before"
    ),
    ("sdk/gsgen/sdk/binding/providers/selection.py", "onnxruntime.InferenceSession"): (
        "the gate to sessions: require_loadable is called before"
    ),
    ("contract/gsgen/contract/probing/sandbox_worker.py", "onnxruntime.InferenceSession"): (
        "the parent called require_loadable, in `execute`"
    ),
    ("sdk/gsgen/sdk/binding/bound/warm_up.py", "onnx.load"): (
        "open_model told before that the model names no other file"
    ),
    ("sdk/gsgen/sdk/float16/instrumented_model.py", "onnxruntime.InferenceSession"): _OWN_FILES,
    ("contract/gsgen/contract/model/installed_runtime.py", "onnxruntime.InferenceSession"): (
        "opens a model of one node that it builds, from memory"
    ),
    ("contract/gsgen/contract/probing/sandbox.py", "numpy.load"): _OWN_FILES,
    ("contract/gsgen/contract/probing/sandbox_worker.py", "numpy.load"): _OWN_FILES,
    ("runtime/gsgen/tiles/build/octree.py", "numpy.load"): _OWN_FILES,
    ("runtime/gsgen/tiles/build/spill.py", "numpy.load"): _OWN_FILES,
    ("runtime/gsgen/tiles/build/tasks.py", "numpy.load"): _OWN_FILES,
    ("runtime/gsgen/runtime/web/npm_files.py", "tarfile.open"): (
        "the archive has a digest that this file states; files are read by name, none is extracted"
    ),
    ("contract/gsgen/conformance/viewer_kit/check_viewer.py", "numpy.load"): (
        "part of a script that runs alone; reads the kit's own pictures"
    ),
    ("contract/gsgen/conformance/viewer_kit/picture_files.py", "numpy.load"): (
        "part of a script that runs alone; reads pictures of the user's viewer, 64 MiB at most"
    ),
}
"""File and call → why the call is safe there."""


def _aliases(nodes: list[ast.AST]) -> dict[str, str]:
    """Map each name that a file imports to its dotted name."""
    names: dict[str, str] = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                root = alias.name.partition(".")[0]
                names[alias.asname or root] = alias.name if alias.asname else root
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                names[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    return names


def _dotted(node: ast.expr, aliases: dict[str, str]) -> str:
    """Return the dotted name of a use of a name or an attribute; empty for another owner."""
    words: list[str] = []
    while isinstance(node, ast.Attribute):
        words.append(node.attr)
        node = node.value
    if not isinstance(node, ast.Name):
        return ""
    return ".".join([aliases.get(node.id, node.id), *reversed(words)])


_WORDS = re.compile(
    r"\b("
    + "|".join(sorted({n.removesuffix(".*").rpartition(".")[2] or "zipfile" for n in RAW_CALLS}))
    + r")\b"
)


def _is_raw(name: str) -> bool:
    owners = [f"{name.rsplit('.', count)[0]}.*" for count in range(1, name.count(".") + 1)]
    return name in RAW_CALLS or any(owner in RAW_CALLS for owner in owners)


def raw_calls(code: str) -> Iterator[str]:
    """Yield each use of a function that reads bytes without a check."""
    nodes = list(ast.walk(ast.parse(code)))
    aliases = _aliases(nodes)
    safe = {
        id(call.func)
        for call in nodes
        if isinstance(call, ast.Call)
        and any(
            word.arg == "weights_only" and getattr(word.value, "value", None) is True
            for word in call.keywords
        )
    }
    inner = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    for node in nodes:
        if not isinstance(node, (ast.Attribute, ast.Name)) or id(node) in inner:
            continue
        if isinstance(node, ast.Attribute) and node.attr in _ANY_OWNER:
            yield f"zipfile.*.{node.attr}"
            continue
        name = _dotted(node, aliases)
        if _is_raw(name) and not (name == "torch.load" and id(node) in safe):
            yield name


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("import numpy as np\nnp.load(p)", ["numpy.load"]),
        ("from numpy import load as f\nf(p)", ["numpy.load"]),
        ("import onnx_ir as ir\nread = ir.load\nread(p)", ["onnx_ir.load"]),
        ("import onnx.external_data_helper as e\ne.load(p)", ["onnx.external_data_helper.load"]),
        ("def f():\n  import onnxruntime\n  onnxruntime.InferenceSession(p)",
         ["onnxruntime.InferenceSession"]),
        ("from onnxruntime import InferenceSession\nInferenceSession(p)",
         ["onnxruntime.InferenceSession"]),
        ("import torch\ntorch.load(p)", ["torch.load"]),
        ("import torch\ntorch.load(p, weights_only=False)", ["torch.load"]),
        ("import torch\ntorch.load(p, weights_only=True)", []),
        ("import pickle\nclass A(pickle.Unpickler): pass", ["pickle.Unpickler"]),
        ("import pickle\ntry: f()\nexcept pickle.UnpicklingError: pass", []),
        ("import joblib\njoblib.load(p)", ["joblib.load"]),
        ("import zipfile\nzipfile.ZipFile(p).extractall()", ["zipfile.*.extractall"]),
        ("archive.extractall(folder)", ["zipfile.*.extractall"]),
        ("eval(text)", ["eval"]),
        ("import json\njson.load(p)", []),
        ("model.eval()", []),
    ],
)  # fmt: skip
def test_a_raw_call_is_found_by_every_name(code, names):
    assert list(raw_calls(code)) == names


def test_the_page_on_security_names_gates_that_exist():
    page = (ROOT / "SECURITY.md").read_text("utf-8").partition("### The gates")[2]
    names = re.findall(r"`(gsgen\.[\w.]+)`", page)
    assert len(names) == 4
    for name in names:
        module, _, function = name.rpartition(".")
        assert callable(getattr(import_module(module), function))


def test_untrusted_bytes_are_read_by_the_gates_alone():
    called_gates = {
        (path.relative_to(ROOT).as_posix(), name)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if _WORDS.search(code := path.read_text("utf-8"))
        for name in raw_calls(code)
    }
    assert called_gates == set(GATES)

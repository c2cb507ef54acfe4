"""Files that nobody should have made: a clear message, exit code 4 or 1, 20 s of a core, 2 GB."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import ModelProto, TensorProto

from support.commands import MeasuredRun, gsgen_here, measured_gsgen

SECONDS = 20
BYTES = 2 << 30
# No manifest: these files are judged as what they are, not as generators that went wrong.
HEAD = '<ir_version: 8, opset_import: ["" : 18]> '


def text(body: str) -> bytes:
    return onnx.parser.parse_model(HEAD + body).SerializeToString()


def valid_model_bytes() -> bytes:
    rng = np.random.default_rng(0)
    model = onnx.parser.parse_model(
        HEAD + "g () => (float[64, 10] gaussians) { gaussians = Neg(w) }"
    )
    weight = onnx.numpy_helper.from_array(rng.normal(size=(64, 10)).astype(np.float32), "w")
    model.graph.initializer.append(weight)
    return model.SerializeToString()


def external(location: str) -> bytes:
    model = ModelProto.FromString(valid_model_bytes())
    weight = model.graph.initializer[0]
    weight.ClearField("raw_data")
    weight.data_location = TensorProto.EXTERNAL
    weight.external_data.add(key="location", value=location)
    return model.SerializeToString()


def nested(depth: int) -> bytes:
    """A graph in a graph in a graph, written by hand: protobuf itself refuses to."""

    def field(number: int, body: bytes) -> bytes:
        size, remaining = b"", len(body)
        while remaining > 0x7F:
            size, remaining = size + bytes([remaining & 0x7F | 0x80]), remaining >> 7
        return bytes([number << 3 | 2]) + size + bytes([remaining]) + body

    graph = field(2, b"innermost")
    for _ in range(depth):
        branch = field(1, b"then_branch") + field(6, graph) + b"\xa0\x01\x05"
        graph = field(1, field(1, b"c") + field(4, b"If") + field(5, branch)) + field(2, b"g")
    return b"\x08\x08" + field(7, graph) + field(8, b"\x10\x12")


def huge_expand() -> bytes:
    return text(
        "g (int64[2] n) => (float[1099511627776, 10] gaussians) "
        "<float[1] w = {0}> { gaussians = Expand(w, n) }"
    )


def asks_for_memory() -> bytes:
    """A small file whose run needs 64 GB."""
    return text(
        "g () => (float[4, 10] gaussians) <int64[2] n = {1600000000, 10}, float[1] v = {1}> "
        "{ big = Expand(v, n)\n r = ReduceSum<keepdims = 0>(big)\n"
        " s = Constant<value_ints = [4, 10]>()\n gaussians = Expand(r, s) }"
    )


def loops_for_ever() -> bytes:
    return text(
        "g () => (float[4, 10] gaussians) <int64 n = {9000000000000000000}, bool c = {1}, "
        "float[1] v = {1}, int64[2] s = {4, 10}> { r = Loop (n, c, v) <body = b (int64 i, bool k, "
        "float[1] a) => (bool k2, float[1] a2) { k2 = Identity(k)\n a2 = Sin(a) }>\n"
        " gaussians = Expand(r, s) }"
    )


FILES: dict[str, Callable[[], bytes]] = {
    "empty": lambda: b"",
    "one byte": lambda: b"\x08",
    "text": lambda: b"this is no model\n" * 100,
    "html": lambda: b"<!DOCTYPE html><html></html>",
    "json": lambda: b'{"ir_version": 8}',
    "zip": lambda: b"PK\x03\x04" + bytes(200),
    "ply": lambda: b"ply\nformat ascii 1.0\n",
    "pointer": lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n",
    "zeros": lambda: bytes(100_000),
    "ones": lambda: b"\xff" * 100_000,
    "random": lambda: np.random.default_rng(1).bytes(200_000),
    "half": lambda: valid_model_bytes()[: len(valid_model_bytes()) // 2],
    "all but a byte": lambda: valid_model_bytes()[:-1],
    "header only": lambda: valid_model_bytes()[:10],
    "random tail": lambda: valid_model_bytes()[:400] + np.random.default_rng(2).bytes(3000),
    "many fields": lambda: b"\x08\x01" * 6_000_000,
    "no graph": lambda: ModelProto(ir_version=8).SerializeToString(),
    "empty graph": lambda: text("g () => () { }"),
    "external outside": lambda: external("../../../etc/passwd"),
    "external absolute": lambda: external("/etc/passwd"),
    "external missing": lambda: external("weights.bin"),
    "external windows": lambda: external("C:\\secret.bin"),
    "cyclic": lambda: text(
        "g (float[4, 10] x) => (float[4, 10] gaussians) "
        "{ a = Add(x, b)\n b = Neg(a)\n gaussians = Neg(b) }"
    ),
    "custom operator": lambda: text(
        "g (float[4, 10] x) => (float[4, 10] gaussians) { gaussians = acme.Splat(x) }"
    ),
    "unknown operator": lambda: text(
        "g (float[4, 10] x) => (float[4, 10] gaussians) { gaussians = Splatter(x) }"
    ),
    "huge dimension": huge_expand,
    "negative dimension": lambda: text(
        "g (float[-4, 10] x) => (float[-4, 10] gaussians) { gaussians = Neg(x) }"
    ),
    "asks for memory": asks_for_memory,
    "loops for ever": loops_for_ever,
    "nested 30 deep": lambda: nested(30),
    "nested 3000 deep": lambda: nested(3000),
    "unknown opset": lambda: text("g () => () { }").replace(b"\x10\x12", b"\x10\x7f"),
}


Judge = Callable[[str], tuple[Path, MeasuredRun]]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    """Validate a file once, however many tests ask for it."""

    @cache
    def run(name: str) -> tuple[Path, MeasuredRun]:
        path = tmp_path_factory.mktemp("hostile") / "model.onnx"
        path.write_bytes(FILES[name]())
        return path, measured_gsgen("validate", path, "--timeout", "4")

    return run


@pytest.mark.parametrize("name", FILES)
def test_a_hostile_file_ends_in_a_clear_message(judge: Judge, name: str) -> None:
    path, completed = judge(name)
    words = completed.out + completed.err
    assert completed.code in (1, 4), words
    assert "Traceback" not in words
    assert "internal" not in words
    assert str(path) in words
    assert len(words) < 20_000
    assert completed.seconds < SECONDS
    assert completed.peak_bytes < BYTES


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("external outside", "GS001"),
        ("external absolute", "GS001"),
        ("external missing", "GS001"),
        ("external windows", "GS001"),
        ("cyclic", "GG019"),
        ("custom operator", "GG002"),
        ("huge dimension", "GS002"),
        ("negative dimension", "GS002"),
        ("asks for memory", "GS004"),
        ("loops for ever", "GS004"),
    ],
)
def test_hostile_file_message_names_the_fault(judge: Judge, name: str, rule: str) -> None:
    _, completed = judge(name)
    assert completed.code == 1
    assert f"{rule} error" in completed.out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("empty", "is empty (0 bytes)"),
        ("zip", "a damaged or cut off ZIP archive"),
        ("ply", "a PLY file without vertices"),
        ("pointer", "git lfs pull"),
        ("half", "damaged or cut off at byte"),
        ("no graph", "holds no ONNX graph"),
    ],
)
def test_non_model_file_is_named(judge: Judge, name: str, words: str) -> None:
    _, completed = judge(name)
    assert completed.code == 4
    assert words in completed.err


def test_a_missing_file_and_a_folder_are_no_models(tmp_path: Path) -> None:
    for path, code in ((tmp_path / "none.onnx", 4), (tmp_path, 2)):
        completed = gsgen_here("validate", path)
        assert completed.code == code
        assert str(path) in completed.err

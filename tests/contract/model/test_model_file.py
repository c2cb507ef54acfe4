import os
import stat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import AttributeProto, ModelProto, SparseTensorProto, TensorProto, TrainingInfoProto

import gsgen.contract.model.model_file as module
from gsgen.contract.errors import ManifestInvalid, ModelUnreadable
from gsgen.contract.model.model_file import (
    MANIFEST_KEY,
    STUB_BYTES,
    ExternalRef,
    open_model,
    write_manifest,
)
from gsgen.contract.spec.manifest import GeneratorManifest, GeneratorOutputs
from gsgen.contract.spec.manifest_io import dumps, loads
from support.models.small_models import good_rows, manifest_of, model, moving, save, weight

SMALL_MODEL = model("tiny (float[2] x) => (float[2] y) <float[2] w = {1, 2}> { y = Add (x, w) }")
REWRITE_HINT = (
    "\n  Write the file again; a partial download or an interrupted export looks like this."
)


def refusal(path):
    """The text of the error over ``path``, without the path that it begins with."""
    with pytest.raises(ModelUnreadable) as caught:
        open_model(path)
    assert caught.value.where == str(path)
    return str(caught.value).removeprefix(f"{path}: ")


def test_a_model_is_opened_without_its_weights(tmp_path):
    path = save(tmp_path / "a.onnx", moving(good_rows(1000)), manifest_of(1000))
    opened = open_model(str(path))
    assert opened.path == path
    assert opened.size == path.stat().st_size
    assert opened.stripped_bytes > 50_000
    assert opened.proto.ByteSize() < 3000
    stubs = {t.name for t in opened.proto.graph.initializer if t.raw_data == STUB_BYTES}
    assert stubs == {"rows", "colors"}
    assert opened.external == ()


def test_the_manifest_and_other_metadata_are_read(tmp_path):
    proto = ModelProto()
    proto.CopyFrom(SMALL_MODEL)
    for key, value in {"author": "me", "a": "1"}.items():
        proto.metadata_props.add(key=key, value=value)
    path = save(tmp_path / "a.onnx", proto)
    assert open_model(path).manifest_text is None
    write_manifest(path, manifest_of(1), path)
    assert open_model(path).metadata.keys() == {"author", "a", MANIFEST_KEY}
    assert loads(open_model(path).manifest_text) == manifest_of(1)


def test_last_value_of_a_repeated_metadata_key_wins(tmp_path):
    proto = ModelProto()
    proto.CopyFrom(SMALL_MODEL)
    for value in ("first", "second"):
        proto.metadata_props.add(key="key", value=value)
    assert open_model(save(tmp_path / "a.onnx", proto)).metadata == {"key": "second"}


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is empty (0 bytes), expected an ONNX model"),
        (b"PK\x03\x04" + bytes(40), "is not an ONNX model but a damaged or cut off ZIP archive"),
        (b"ply\nformat ascii 1.0\n", "is not an ONNX model but a PLY file without vertices"),
        (b"\x80\x02}q\x00.", "is not an ONNX model but a pickle"),
        (b"<!DOCTYPE html><html></html>", "is not an ONNX model but a web page (HTML)"),
        (b'{"contract": "1.0"}', "is not an ONNX model but a JSON document"),
        (b"\x18\0\0\0ORTM" + bytes(64), "is not an ONNX model but a model in ONNX Runtime's own"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n",
            "is not an ONNX model but a git LFS pointer\n  The file itself is not here: fetch it with `git lfs pull`.",
        ),
        (b"Hello, world!\n", "is not an ONNX model but text"),
        (
            b"\x02\x01" + bytes(range(100)),
            "is damaged or cut off at byte 0: protobuf field number 0, expected 1 or more"
            + REWRITE_HINT,
        ),
        (bytes(100), "is not an ONNX model but a file that begins with zeros only"),
        (b"\x3a\x03\x0a\x7f\x0a", "does not parse as ONNX ("),
        (b"\x08\x0a", "holds no ONNX graph" + REWRITE_HINT),
        (b"\x3a\x00", "holds no ONNX graph" + REWRITE_HINT),
    ],
)
def test_a_file_of_another_kind_is_named_as_such(tmp_path, content, text):
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    assert refusal(path).startswith(text)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("absent.onnx", "cannot be read: No such file or directory"),
        ("a" * 300, "cannot be read: File name too long"),
        (".", "is a folder, expected an ONNX file"),
    ],
)
def test_missing_file_is_reported(tmp_path, name, text):
    assert refusal(tmp_path / name) == text


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_refused_without_waiting_for_a_writer(tmp_path):
    pipe = tmp_path / "pipe.onnx"
    os.mkfifo(pipe)
    assert refusal(pipe) == "is not a regular file, expected an ONNX file"
    with pytest.raises(ModelUnreadable):
        write_manifest(pipe, manifest_of(1), tmp_path / "b.onnx")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no devices on this system")
def test_a_device_is_refused():
    assert refusal(Path("/dev/zero")) == "is not a regular file, expected an ONNX file"


def opens(path: Path, content: bytes) -> bool:
    """Whether ``content`` opens; anything raised but ModelUnreadable fails the test."""
    path.write_bytes(content)
    try:
        open_model(path)
    except ModelUnreadable as error:
        text = str(error)
    else:
        return True
    assert len(text.splitlines()) <= 2
    return False


def test_every_point_of_truncation_gives_a_model_or_an_error(tmp_path):
    content = save(tmp_path / "a.onnx", SMALL_MODEL, manifest_of(1)).read_bytes()
    body = len(SMALL_MODEL.SerializeToString())
    for size in range(len(content)):
        whole = opens(tmp_path / "part.onnx", content[:size])
        assert not whole or size >= body - 10  # the opset and the manifest are not missed


@settings(max_examples=300)
@given(
    edits=st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 255)), min_size=1, max_size=4)
)
def test_flipped_bytes_give_a_model_or_an_error(tmp_path_factory, edits):
    content = bytearray(SMALL_MODEL.SerializeToString())
    for offset, value in edits:
        content[offset % len(content)] = value
    opens(tmp_path_factory.getbasetemp() / "flipped.onnx", bytes(content))


def test_a_name_that_is_no_text_is_refused(tmp_path):
    content = SMALL_MODEL.SerializeToString()
    path = tmp_path / "a.onnx"
    path.write_bytes(content.replace(b"\x0a\x01x", b"\x0a\x01\xff"))
    assert refusal(path) == f"has a name that is not valid UTF-8 (b'\\xff'){REWRITE_HINT}"


def external(name, location="weights.bin", **entries):
    """A float [3] whose values lie in another file."""
    tensor_proto = TensorProto(name=name, data_type=TensorProto.FLOAT, dims=[3])
    tensor_proto.data_location = TensorProto.EXTERNAL
    for key, value in {"location": location, **entries}.items():
        tensor_proto.external_data.add(key=key, value=value)
    return tensor_proto


def attribute(**value):
    return AttributeProto(name="value", **value)


def model_with_external_data(name):
    """A model with external data in one of the places that a file has for tensors."""
    text = "m (float[3] x) => (float[3] y) { y = Add (x, x) }"
    proto = model(text)
    graph, node = proto.graph, proto.graph.node[0]
    tensor = external("w")
    sparse = SparseTensorProto(values=tensor, dims=[9])
    if name == "initializer":
        graph.initializer.append(tensor)
    elif name == "sparse_initializer":
        graph.sparse_initializer.append(sparse)
    elif name == "subgraph":
        node.attribute.add(name="body").g.initializer.append(tensor)
    elif name == "subgraphs":
        both = node.attribute.add(name="body")
        both.g.name = "decoy"
        both.graphs.add().initializer.append(tensor)
    elif name == "function":
        node = proto.functions.add(name="f").node.add(op_type="Constant")
        node.attribute.append(attribute(t=tensor))
    elif name == "default of a function":
        proto.functions.add(name="f").attribute_proto.append(attribute(t=tensor))
    elif name == "training":
        info = TrainingInfoProto()
        info.algorithm.initializer.append(tensor)
        proto.training_info.append(info)
    else:
        is_repeated = name in ("tensors", "sparse_tensors")
        value = sparse if name.startswith("sparse") else tensor
        node.attribute.append(attribute(**{name: [value] if is_repeated else value}))
    return proto


@pytest.mark.parametrize(
    "owner",
    [
        "initializer",
        "sparse_initializer",
        "subgraph",
        "subgraphs",
        "function",
        "default of a function",
        "training",
        "t",
        "tensors",
        "sparse_tensor",
        "sparse_tensors",
    ],
)
def test_external_data_is_found_in_every_kind_of_attribute(tmp_path, owner):
    opened = open_model(save(tmp_path / "a.onnx", model_with_external_data(owner)))
    assert opened.external == (ExternalRef("w", "weights.bin", 0, None),)
    assert b"weights.bin" not in opened.proto.SerializeToString()


@pytest.mark.parametrize(
    ("entries", "offset", "length"),
    [
        ({}, 0, None),
        ({"offset": "4096", "length": "12"}, 4096, 12),
        ({"offset": "-1", "length": "many"}, 0, None),
        ({"offset": "²", "length": ""}, 0, None),
    ],
)
def test_the_place_of_external_data_is_read_as_whole_numbers(tmp_path, entries, offset, length):
    proto = model_with_external_data("initializer")
    proto.graph.initializer[0].CopyFrom(external("w", **entries))
    opened = open_model(save(tmp_path / "a.onnx", proto))
    assert opened.external == (ExternalRef("w", "weights.bin", offset, length),)


def files(folder):
    return sorted(path.name for path in folder.iterdir())


def with_metadata(proto, **entries):
    model_proto = ModelProto()
    model_proto.CopyFrom(proto)
    for key, value in entries.items():
        model_proto.metadata_props.add(key=key.replace("_", "."), value=value)
    return model_proto


def test_only_the_manifest_changes_when_one_is_written(tmp_path):
    proto = with_metadata(moving(good_rows(5000)), author="me", gsgen_manifest="old")
    source, target = save(tmp_path / "a.onnx", proto), tmp_path / "b.onnx"
    before = source.read_bytes()
    write_manifest(source, manifest_of(5000), target)
    written_proto = ModelProto.FromString(target.read_bytes())
    assert written_proto.metadata_props.pop().value == dumps(manifest_of(5000), indent=None)
    del proto.metadata_props[1]
    assert written_proto == proto
    assert source.read_bytes() == before
    assert files(tmp_path) == ["a.onnx", "b.onnx"]


def test_bytes_that_no_reader_knows_are_kept(tmp_path):
    source = tmp_path / "a.onnx"
    unknown_field = b"\xba\x3e\x03abc"  # field 999, of no version of ONNX
    source.write_bytes(unknown_field + SMALL_MODEL.SerializeToString() + unknown_field)
    write_manifest(source, manifest_of(1), source)
    assert source.read_bytes().startswith(
        unknown_field + SMALL_MODEL.SerializeToString() + unknown_field
    )
    assert open_model(source).manifest_text


def test_every_earlier_manifest_is_replaced(tmp_path):
    proto = with_metadata(SMALL_MODEL, gsgen_manifest="one", b="2")
    proto.metadata_props.add(key=MANIFEST_KEY, value="two")
    path = save(tmp_path / "a.onnx", proto)
    for capacity in (1, 2):
        write_manifest(path, manifest_of(capacity), path)
    written_proto = ModelProto.FromString(path.read_bytes())
    assert [entry.key for entry in written_proto.metadata_props] == ["b", MANIFEST_KEY]
    assert loads(open_model(path).manifest_text) == manifest_of(2)
    assert files(tmp_path) == ["a.onnx"]


def test_permissions_are_those_of_the_source(tmp_path):
    source = save(tmp_path / "a.onnx", SMALL_MODEL)
    source.chmod(0o640)
    write_manifest(source, manifest_of(1), tmp_path / "b.onnx")
    assert stat.S_IMODE((tmp_path / "b.onnx").stat().st_mode) == 0o640


def test_a_failure_leaves_the_target_as_it_was(tmp_path, monkeypatch):
    path = save(tmp_path / "a.onnx", SMALL_MODEL, manifest_of(1))
    before = path.read_bytes()

    def full(source, out, count):
        out.write(source.read(count // 2))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_copy_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        write_manifest(path, manifest_of(2), path)
    assert path.read_bytes() == before
    assert files(tmp_path) == ["a.onnx"]


def test_a_source_that_shrinks_while_it_is_copied_is_an_error(tmp_path, monkeypatch):
    path = save(tmp_path / "a.onnx", SMALL_MODEL)
    monkeypatch.setattr(module, "_without_manifest", lambda _: [(0, 10**9)])
    with pytest.raises(OSError, match="became shorter while it was copied"):
        write_manifest(path, manifest_of(1), tmp_path / "b.onnx")
    assert files(tmp_path) == ["a.onnx"]


def test_a_wrong_manifest_is_not_written(tmp_path):
    path = save(tmp_path / "a.onnx", SMALL_MODEL)
    before = path.read_bytes()
    with pytest.raises(ManifestInvalid):
        write_manifest(path, GeneratorManifest(name="", outputs=GeneratorOutputs()), path)
    assert path.read_bytes() == before


def test_a_file_that_is_no_model_gets_no_manifest(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("Hello, world!")
    with pytest.raises(ModelUnreadable):
        write_manifest(path, manifest_of(1), tmp_path / "b.onnx")
    assert files(tmp_path) == ["a.txt"]


def test_a_folder_that_does_not_exist_is_not_made(tmp_path):
    path = save(tmp_path / "a.onnx", SMALL_MODEL)
    with pytest.raises(FileNotFoundError):
        write_manifest(path, manifest_of(1), tmp_path / "absent" / "b.onnx")


def test_weights_survive_bit_by_bit(tmp_path):
    values = np.random.default_rng(0).integers(0, 256, 3 << 20, np.uint8)
    proto = model("m () => (uint8[SIZE] y) { y = Identity (w) }".replace("SIZE", str(values.size)))
    proto.graph.initializer.append(weight("w", values))
    path = save(tmp_path / "a.onnx", proto)
    write_manifest(path, manifest_of(1), path)
    assert ModelProto.FromString(path.read_bytes()).graph == proto.graph


def weights_at(*ranges):
    """A model whose weights lie at (location, offset, length), as far as given."""
    proto = ModelProto(ir_version=8)
    proto.opset_import.add(domain="", version=18)
    proto.graph.name = "g"
    for index, entries in enumerate(ranges):
        tensor = proto.graph.initializer.add(name=f"w{index}", data_type=1, dims=[250])
        tensor.data_location = TensorProto.EXTERNAL
        for key, value in zip(("location", "offset", "length"), entries, strict=False):
            if value is not None:
                tensor.external_data.add(key=key, value=str(value))
    return proto


@pytest.mark.parametrize(
    ("ranges", "with_external_data"),
    [
        ([("w.bin",)], 1000),
        ([("w.bin", None, 10**12)] * 50, 1000),
        ([("w.bin", 0, 600), ("w.bin", 400, 300)], 700),
        ([("w.bin", 0, 100), ("w.bin", 900, 500)], 200),
        ([("w.bin", 0, 300), ("w.bin", 100, 50), ("w.bin", 200, 200)], 400),
        ([("w.bin", 5000, 10)], 0),
        ([("w.bin", 0, 100), ("v.bin", 0, 100)], 150),
        ([("absent.bin", 0, 100), ("", 0, 1), ("x" * 5000, 0, 1), ("a\0b", 0, 1)], 0),
    ],
)
def test_weights_count_as_far_as_there_are_bytes_and_each_byte_once(
    tmp_path, ranges, with_external_data
):
    (tmp_path / "w.bin").write_bytes(bytes(1000))
    (tmp_path / "v.bin").write_bytes(bytes(50))
    path = save(tmp_path / "m.onnx", weights_at(*ranges))
    file = open_model(path)
    assert file.weight_bytes == path.stat().st_size + with_external_data

import numpy as np
import pytest
from google.protobuf.message import Message
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import (
    AttributeProto,
    FunctionProto,
    GraphProto,
    ModelProto,
    NodeProto,
    SparseTensorProto,
    TensorProto,
    TrainingInfoProto,
)

from gsgen.contract.model import protobuf_scan
from gsgen.contract.model.protobuf_scan import (
    STUB_BYTES,
    Field,
    WireFault,
    scan,
    strip_payloads,
    varint,
)

PAYLOAD = {
    "float_data": (TensorProto.FLOAT, 0.5),
    "int32_data": (TensorProto.FLOAT16, 300),
    "int64_data": (TensorProto.INT64, 300),
    "double_data": (TensorProto.DOUBLE, 0.5),
    "uint64_data": (TensorProto.UINT64, 300),
    "string_data": (TensorProto.STRING, b"word"),
}
SIZES = st.sampled_from([0, 1, 3, 500, 900, 3000])


@st.composite
def tensors(draw):
    storage, size = draw(st.sampled_from([*PAYLOAD, "raw_data"])), draw(SIZES)
    tensor_proto = TensorProto(name=draw(st.text(max_size=3)), dims=[size], doc_string="kept")
    if storage == "raw_data":
        tensor_proto.data_type = draw(st.sampled_from([1, 7, 10]))
        tensor_proto.raw_data = bytes(range(250)) * (size // 50)
    else:
        tensor_proto.data_type, value = PAYLOAD[storage]
        getattr(tensor_proto, storage).extend([value] * size)
    if draw(st.booleans()):
        tensor_proto.data_location = TensorProto.EXTERNAL
        tensor_proto.external_data.add(key="location", value="weights.bin")
    return tensor_proto


sparse = st.builds(SparseTensorProto, values=tensors(), indices=tensors(), dims=st.just([9]))


def attributes(graphs):
    def few(entry):
        return st.lists(entry, max_size=2)

    return st.builds(
        AttributeProto,
        name=st.just("value"),
        t=st.none() | tensors(),
        tensors=few(tensors()),
        g=st.none() | graphs,
        graphs=few(graphs),
        sparse_tensor=st.none() | sparse,
        sparse_tensors=few(sparse),
    )


def nodes(graphs):
    inner = st.lists(attributes(graphs), max_size=1)
    return st.builds(NodeProto, op_type=st.just("If"), attribute=inner)


def graphs(inner):
    return st.builds(
        GraphProto,
        name=st.just("graph"),
        node=st.lists(nodes(inner), max_size=2),
        initializer=st.lists(tensors(), max_size=2),
        sparse_initializer=st.lists(sparse, max_size=1),
        doc_string=st.sampled_from(["", "words " * 500]),
    )


GRAPHS = graphs(graphs(st.just(GraphProto(name="leaf"))))
MODELS = st.builds(
    ModelProto,
    ir_version=st.just(10),
    producer_name=st.just("tests"),
    graph=GRAPHS,
    functions=st.lists(
        st.builds(
            FunctionProto,
            name=st.just("f"),
            node=st.lists(nodes(GRAPHS), max_size=1),
            attribute_proto=st.lists(attributes(GRAPHS), max_size=1),
        ),
        max_size=1,
    ),
    training_info=st.lists(st.builds(TrainingInfoProto, algorithm=GRAPHS), max_size=1),
)


def without_payload(message: Message) -> Message:
    """Clear every tensor in ``message``, wherever it is."""
    if isinstance(message, TensorProto):
        for field in (*PAYLOAD, "raw_data"):
            message.ClearField(field)
    for field, value in message.ListFields():
        if field.type == field.TYPE_MESSAGE:
            for entry in [value] if isinstance(value, Message) else value:
                without_payload(entry)
    return message


@settings(max_examples=60)
@given(MODELS)
def test_a_skeleton_is_the_model_but_for_payload(model):
    data = model.SerializeToString()
    bones = strip_payloads(data)
    assert len(bones.data) <= len(data)
    assert (bones.stripped_bytes == 0) == (bones.data == data)
    proto = ModelProto.FromString(bones.data)
    assert without_payload(proto) == without_payload(model)


def with_weights(*weights: TensorProto) -> bytes:
    return ModelProto(graph=GraphProto(initializer=weights)).SerializeToString()


@pytest.mark.parametrize("storage", PAYLOAD)
def test_a_large_payload_leaves_a_stub_in_every_storage(storage):
    dtype, value = PAYLOAD[storage]
    count = 600_000 if storage == "int64_data" else 10_000
    weight = TensorProto(name="w", data_type=dtype, dims=[count])
    getattr(weight, storage).extend([value] * count)
    bones = strip_payloads(with_weights(weight))
    stub = ModelProto.FromString(bones.data).graph.initializer[0]
    assert stub == TensorProto(name="w", data_type=dtype, dims=[count], raw_data=STUB_BYTES)
    assert bones.stripped_bytes >= 2 * count
    assert len(bones.data) < 100


def test_a_payload_in_several_pieces_is_left_out_whole():
    half = TensorProto(name="w", dims=[1000], float_data=np.ones(500)).SerializeToString()
    raw = GraphProto.FromString(b"")
    head = ModelProto(graph=raw).SerializeToString()
    assert head == b"\x3a\x00"
    tensor = protobuf_scan._header(5, 2 * len(half)) + half + half
    bones = strip_payloads(protobuf_scan._header(7, len(tensor)) + tensor)
    result = ModelProto.FromString(bones.data).graph.initializer[0]
    assert not result.float_data
    assert result.raw_data == STUB_BYTES


@pytest.mark.parametrize(("count", "retained"), [(300, True), (100_000, True), (200_000, False)])
def test_integers_are_kept_up_to_a_mebibyte_for_shape_inference(count, retained):
    values = np.arange(count, dtype=np.int64).tobytes()
    weight = TensorProto(name="w", data_type=TensorProto.INT64, dims=[count], raw_data=values)
    result = ModelProto.FromString(strip_payloads(with_weights(weight)).data).graph.initializer[0]
    assert (result == weight) is retained


def test_a_small_tensor_is_kept_whole():
    weight = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[400], raw_data=b"1234" * 400)
    data = with_weights(weight)
    bones = strip_payloads(data)
    assert (bones.data, bones.stripped_bytes) == (data, 0)


def test_unknown_fields_are_kept():
    unknown_field = protobuf_scan._header(999, 3) + b"abc"
    assert strip_payloads(unknown_field).data == unknown_field


@pytest.mark.parametrize(
    ("number", "data"),
    [(0, b"\x00"), (127, b"\x7f"), (128, b"\x80\x01"), (2**64 - 1, b"\xff" * 9 + b"\x01")],
)
def test_a_varint_is_little_endian_in_groups_of_seven_bits(number, data):
    assert varint(b"?" + data + b"?", 1, len(data) + 1) == (number, len(data) + 1)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\x80", "byte 1: the file ends inside a protobuf number"),
        (b"", "byte 0: the file ends inside a protobuf number"),
        (b"\x80" * 20, "byte 10: a protobuf number of more than ten bytes"),
    ],
)
def test_a_varint_without_end_is_a_fault(data, text):
    with pytest.raises(WireFault) as caught:
        varint(data, 0, len(data))
    assert str(caught.value) == text
    assert caught.value.offset == int(text.split()[1].rstrip(":"))


def test_fields_of_every_wire_type_are_found_where_they_are():
    data = b"\x08\x96\x01" + b"\x12\x02hi" + b"\x1d\0\0\0\0" + b"\x21" + bytes(8)
    assert list(scan(data, 0, len(data))) == [
        Field(number=1, wire_type=0, start=0, value=1, end=3),
        Field(number=2, wire_type=2, start=3, value=5, end=7),
        Field(number=3, wire_type=5, start=7, value=8, end=12),
        Field(number=4, wire_type=1, start=12, value=13, end=21),
    ]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\x12\x05hi", "byte 0: field 2 needs 3 more bytes than the message has"),
        (b"\x08\x01\x1d\0", "byte 2: field 3 needs 3 more bytes than the message has"),
        (b"\x21\0", "byte 0: field 4 needs 7 more bytes than the message has"),
        (b"\x0b", "byte 0: protobuf wire type 3, which ONNX does not use"),
        (b"\x0f", "byte 0: protobuf wire type 7, which ONNX does not use"),
        (b"\x00\x01", "byte 0: protobuf field number 0, expected 1 or more"),
        (
            b"\x12" + b"\xff" * 9 + b"\x01",
            "byte 0: field 2 needs 18446744073709551615 more bytes than the message has",
        ),
    ],
)
def test_a_malformed_field_is_a_fault_with_its_place(data, text):
    with pytest.raises(WireFault) as caught:
        list(scan(data, 0, len(data)))
    assert str(caught.value) == text


def nested(depth):
    """A model of graphs in graphs; protobuf itself would not write it."""
    data = GraphProto(name="innermost", doc_string="x" * 3000).SerializeToString()
    for _ in range(depth):
        for number in (6, 5, 1):  # a graph, in an attribute, in a node
            data = protobuf_scan._header(number, len(data)) + data
    return protobuf_scan._header(7, len(data)) + data


def test_graphs_may_be_nested_but_not_without_end():
    assert strip_payloads(nested(30)).data == nested(30)
    with pytest.raises(WireFault, match="graphs are nested more than 100 deep"):
        strip_payloads(nested(40))


def test_the_number_of_fields_is_limited(monkeypatch):
    monkeypatch.setattr(protobuf_scan, "_MAX_FIELDS", 100)
    assert strip_payloads(b"\x08\x01" * 100)
    with pytest.raises(WireFault, match="more than 100 protobuf fields"):
        strip_payloads(b"\x08\x01" * 101)


def test_retained_bytes_besides_payload_are_limited(monkeypatch):
    monkeypatch.setattr(protobuf_scan, "_MAX_RETAINED_BYTES", 1 << 20)
    model = ModelProto(doc_string="x" * (1 << 20)).SerializeToString()
    with pytest.raises(WireFault, match="more than 1 MiB besides tensor payload"):
        strip_payloads(model)

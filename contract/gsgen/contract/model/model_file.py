"""Opens an ONNX file without reading its weights: graph structure, manifest, weight location."""

__all__ = [
    "MANIFEST_KEY",
    "NEUTRAL_KEY",
    "STUB_BYTES",
    "ExternalRef",
    "ModelFile",
    "bodies",
    "declared_opset",
    "open_model",
    "parse_length",
    "small_array",
    "subgraphs",
    "write_manifest",
    "write_manifest_text",
]

import mmap
import os
import shutil
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from google.protobuf.message import DecodeError
from onnx import (
    AttributeProto,
    FunctionProto,
    GraphProto,
    ModelProto,
    StringStringEntryProto,
    TensorProto,
    numpy_helper,
)

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.model.protobuf_scan import (
    BYTES,
    STUB_BYTES,
    StrippedModel,
    WireFault,
    scan,
    strip_payloads,
)
from gsgen.contract.process.atomic_files import similar_file_hint
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN

Body = GraphProto | FunctionProto

MANIFEST_KEY = "gsgen.manifest"
"""The key that this project writes."""

NEUTRAL_KEY = "gaussian-generator.manifest"
"""The same for tools that do not want to name this project; it is read where the first is absent."""

_MANIFEST_KEYS = (MANIFEST_KEY, NEUTRAL_KEY)
_METADATA_FIELD = 14  # ModelProto.metadata_props
_MAX_LENGTH = (1 << 63) - 1
_MAX_DIGIT_COUNT = 100  # Python refuses to read numbers of thousands


@dataclass(frozen=True, slots=True)
class ExternalRef:
    """A tensor whose data lie in another file (ONNX external data).

    Attributes:
        tensor: Its name.
        location: The path as written in the model, relative to the model's folder.
        offset: First byte in that file.
        length: Number of bytes, or None where the model does not say.
    """

    tensor: str
    location: str
    offset: int
    length: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFile:
    """The structure of an ONNX model; the weights stay in the file.

    Attributes:
        path: The file.
        size: Its size, in bytes.
        proto: The model, with stubs in place of large payloads and of external data.
        stripped: Number of payload bytes that were not read.
        external: Tensors whose payload lies in other files.
        external_tensors: The same tensors as the model declares them, in the same order.
        whole: Whether every payload was read and no weight is sparse.
    """

    path: Path
    size: int
    proto: ModelProto
    stripped_bytes: int
    external: tuple[ExternalRef, ...]
    external_tensors: tuple[TensorProto, ...] = ()
    whole: bool = False

    @property
    def metadata(self) -> dict[str, str]:
        """The model's ``metadata_props`` as a mapping; a repeated key keeps its last value."""
        return {entry.key: entry.value for entry in self.proto.metadata_props}

    @property
    def loading_path(self) -> Path:
        """The absolute path from whose folder the model's external weights are found.

        It is ``path``, or the real file if ``path`` is a link without the weights beside it.
        """
        named_path = self.path.parent.resolve() / self.path.name
        has_all_external_files = all(
            os.path.lexists(named_path.parent / ref.location) for ref in self.external
        )
        return named_path if has_all_external_files else named_path.resolve()

    @property
    def weight_bytes(self) -> int:
        """The bytes of the model file and of its external weights, each byte counted once.

        Declared lengths count only as far as the external files reach.
        """
        folder = self.loading_path.parent
        ranges: dict[str, list[tuple[int, int]]] = {}
        for ref in self.external:
            end = _MAX_LENGTH if ref.length is None else ref.offset + ref.length
            ranges.setdefault(ref.location, []).append((ref.offset, end))
        external_sizes = (_covered_bytes(folder, *item) for item in ranges.items())
        return self.size + sum(external_sizes)

    @property
    def manifest_text(self) -> str | None:
        """The JSON text of the manifest embedded in the model, or None."""
        metadata = self.metadata
        return metadata.get(MANIFEST_KEY, metadata.get(NEUTRAL_KEY))


def _covered_bytes(folder: Path, location: str, ranges: list[tuple[int, int]]) -> int:
    """Return the size in bytes of the union of byte ranges of a file; 0 if the file is missing."""
    try:
        entry = (folder / location).stat()
        size = entry.st_size if stat.S_ISREG(entry.st_mode) else 0
    except (OSError, ValueError):  # a rule reports it
        return 0
    total = covered_byte_end = 0
    for start, end in sorted(ranges):
        start, end = max(start, covered_byte_end), min(end, size)
        total += max(0, end - start)
        covered_byte_end = max(covered_byte_end, end)
    return total


def open_model(path: str | os.PathLike[str]) -> ModelFile:
    """Open an ONNX file without reading its weights.

    Raises:
        ModelUnreadable: There is no such file, or it is not an ONNX model.
    """
    path = Path(path)
    size = _size(path)
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            stripped_model = _strip_weights(path, view)
    except OSError as error:
        raise ModelUnreadable(f"cannot be read: {error.strerror}", where=str(path)) from error
    proto = _parse_model(path, stripped_model.data)
    parts = list(bodies(proto))
    _check_texts(path, proto, parts)
    detached_weights = list(_detach_external_weights(parts))
    external = tuple(ref for ref, _ in detached_weights)
    whole = not (stripped_model.stripped_bytes or external or any(map(_has_sparse_tensor, parts)))
    return ModelFile(
        path=path,
        size=size,
        proto=proto,
        stripped_bytes=stripped_model.stripped_bytes,
        external=external,
        external_tensors=tuple(tensor for _, tensor in detached_weights),
        whole=whole,
    )


def _size(path: Path) -> int:
    where = str(path)
    try:
        entry = path.stat()
    except OSError as error:
        hint = similar_file_hint(path) if isinstance(error, FileNotFoundError) else ""
        raise ModelUnreadable(
            f"cannot be read: {error.strerror}", where=where, hint=hint
        ) from error
    if stat.S_ISDIR(entry.st_mode):
        raise _folder_error(path)
    if not stat.S_ISREG(entry.st_mode):
        raise ModelUnreadable("is not a regular file, expected an ONNX file", where=where)
    if entry.st_size == 0:
        raise ModelUnreadable("is empty (0 bytes), expected an ONNX model", where=where)
    return entry.st_size


def _folder_error(path: Path) -> ModelUnreadable:
    from gsgen.contract.file_kinds.folder_kinds import kind_of_folder

    models = sorted(path.glob("*.onnx"))
    kind = None if models else kind_of_folder(path)
    title = "a folder" if kind is None else kind.title
    hint = "" if kind is None else kind.hint
    if models:
        hint = f"It holds {len(models)}: name {models[0]}, or {path}/*.onnx."
    return ModelUnreadable(f"is {title}, expected an ONNX file", where=str(path), hint=hint)


def _strip_weights(path: Path, view: mmap.mmap) -> StrippedModel:
    with memoryview(view) as data:
        try:
            return strip_payloads(data)
        except WireFault as fault:
            raise _not_onnx_error(path, f"is damaged or cut off at {fault}") from fault


def _parse_model(path: Path, data: bytes) -> ModelProto:
    try:
        proto = ModelProto.FromString(data)
    except (DecodeError, RecursionError) as error:
        raise _not_onnx_error(path, f"does not parse as ONNX ({error})") from error
    if not proto.HasField("graph") or not (proto.ir_version or proto.opset_import):
        raise _not_onnx_error(path, "holds no ONNX graph")
    return proto


def _check_texts(path: Path, proto: ModelProto, parts: list[Body]) -> None:
    for text in _texts_of_model(proto, parts):
        if isinstance(text, bytes):  # protobuf returns bytes that are not valid UTF-8
            raise _not_onnx_error(path, f"has a name that is not valid UTF-8 ({text[:32]!r})")


def _has_sparse_tensor(body: Body) -> bool:
    return isinstance(body, GraphProto) and bool(body.sparse_initializer)


def _not_onnx_error(path: Path, message: str) -> ModelUnreadable:
    from gsgen.contract.file_kinds.recognition import kind_of_file

    kind = kind_of_file(path)
    if kind is not None and kind.name != "onnx":
        message = f"is not an ONNX model but {kind.title}"
        return ModelUnreadable(message, where=str(path), hint=kind.hint)
    suffix = path.suffix.lower()
    if kind is None and suffix not in ("", ".onnx"):
        message = f"is not an ONNX model; by its name, it is a {suffix} file"
    hint = "Write the file again; a partial download or an interrupted export looks like this."
    return ModelUnreadable(message, where=str(path), hint=hint)


def _detach_external_weights(parts: list[Body]) -> Iterator[tuple[ExternalRef, TensorProto]]:
    """Replace the data of external tensors by a stub; yield the place of the data, and the rest."""
    for tensor in _tensors(parts):
        if tensor.data_location != TensorProto.EXTERNAL:
            continue
        entries = {entry.key: entry.value for entry in tensor.external_data}
        # Libraries differ in which of two locations they read.
        locations = [entry.value for entry in tensor.external_data if entry.key == "location"]
        declared = TensorProto(
            name=tensor.name,
            data_type=tensor.data_type,
            dims=tensor.dims,
            external_data=tensor.external_data,
        )
        tensor.ClearField("external_data")
        tensor.ClearField("data_location")
        tensor.raw_data = STUB_BYTES
        for location in locations or [""]:
            ref = ExternalRef(
                tensor.name,
                location,
                parse_length(entries.get("offset")) or 0,
                parse_length(entries.get("length")),
            )
            yield ref, declared


def parse_length(text: str | None) -> int | None:
    """Parse a non-negative decimal number; return None if ``text`` is None or not a number."""
    if text is None or not (text.isascii() and text.isdigit()):
        return None
    return min(int(text), _MAX_LENGTH) if len(text) <= _MAX_DIGIT_COUNT else _MAX_LENGTH


def bodies(proto: ModelProto) -> Iterator[Body]:
    """Yield every graph of a model: the main graph, function bodies, and subgraphs of nodes."""
    queue: list[Body] = [proto.graph, *proto.functions]
    for training_info in proto.training_info:
        queue += [training_info.initialization, training_info.algorithm]
    while queue:
        body = queue.pop()
        yield body
        for attribute in _attributes(body):
            queue += subgraphs(attribute)


def declared_opset(proto: ModelProto) -> int | None:
    """Return the version of the ONNX operator set that a model declares; None without one."""
    versions = {entry.domain: entry.version for entry in proto.opset_import}
    return next((versions[domain] for domain in MAIN_DOMAIN if domain in versions), None)


def subgraphs(attribute: AttributeProto) -> list[GraphProto]:
    """Return the subgraphs that a node attribute holds."""
    return [*([attribute.g] if attribute.HasField("g") else ()), *attribute.graphs]


def _attributes(body: Body) -> Iterator[AttributeProto]:
    if isinstance(body, FunctionProto):
        yield from body.attribute_proto
    for node in body.node:
        yield from node.attribute


def _tensors(parts: list[Body]) -> Iterator[TensorProto]:
    """Yield every weight tensor of a model, including those in subgraphs and functions."""
    for body in parts:
        if isinstance(body, GraphProto):
            yield from body.initializer
            for sparse in body.sparse_initializer:
                yield from (sparse.values, sparse.indices)
        for attribute in _attributes(body):
            yield from _attribute_tensors(attribute)


def _attribute_tensors(attribute: AttributeProto) -> Iterator[TensorProto]:
    if attribute.HasField("t"):
        yield attribute.t
    yield from attribute.tensors
    if attribute.HasField("sparse_tensor"):
        yield from (attribute.sparse_tensor.values, attribute.sparse_tensor.indices)
    for sparse in attribute.sparse_tensors:
        yield from (sparse.values, sparse.indices)


def _texts_of_model(proto: ModelProto, parts: list[Body]) -> Iterator[str]:
    """Yield every name and string of an ONNX model that validation rules read."""
    for entry in proto.metadata_props:
        yield from (entry.key, entry.value)
    for opset in proto.opset_import:
        yield opset.domain
    for function in proto.functions:
        yield from (function.domain, function.name)
    for body in parts:
        if isinstance(body, GraphProto):
            for value in (*body.input, *body.output, *body.value_info):
                yield value.name
                yield from (dim.dim_param for dim in value.type.tensor_type.shape.dim)
        for node in body.node:
            yield from (node.op_type, node.domain, node.name, *node.input, *node.output)
    for tensor in _tensors(parts):
        yield tensor.name
        for pair in tensor.external_data:
            yield from (pair.key, pair.value)


def write_manifest(
    source: str | os.PathLike[str], manifest: Manifest, target: str | os.PathLike[str]
) -> None:
    """Copy ONNX file ``source`` to ``target`` with ``manifest`` as the only embedded manifest.

    The weights are copied in chunks and never parsed; ``target`` may be ``source``. The copy
    has a temporary name until it is complete, so a failure changes nothing.

    Raises:
        ManifestInvalid: ``manifest`` does not follow its schema.
        ModelUnreadable: ``source`` is not an ONNX model.
        OSError: ``target`` cannot be written.
    """
    write_manifest_text(Path(source), dumps(manifest, indent=None), Path(target))


def write_manifest_text(source: Path, text: str, target: Path) -> None:
    """Copy a model file, and embed a manifest given as JSON text."""
    entry = StringStringEntryProto(key=MANIFEST_KEY, value=text)
    metadata_bytes = ModelProto(metadata_props=[entry]).SerializeToString()
    open_model(source)  # raises if the source is not a model
    with temporary_folder(target.parent) as folder:
        draft = folder / target.name
        with draft.open("xb") as out, source.open("rb") as file:
            for start, end in _without_manifest(file.fileno()):
                file.seek(start)
                _copy_bytes(file, out, end - start)
            out.write(metadata_bytes)  # protobuf allows a repeated field anywhere in the message
        shutil.copymode(source, draft)
        draft.replace(target)


def _without_manifest(descriptor: int) -> list[tuple[int, int]]:
    """Return the byte ranges of a model file without those of its embedded manifest."""
    ranges: list[tuple[int, int]] = []
    with mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ) as view, memoryview(view) as data:
        for field in scan(data, 0, len(data)):
            if field.number == _METADATA_FIELD and _is_manifest(data, field.value, field.end):
                continue
            if ranges and ranges[-1][1] == field.start:
                ranges[-1] = (ranges[-1][0], field.end)
            else:
                ranges.append((field.start, field.end))
    return ranges


def _is_manifest(data: memoryview, start: int, end: int) -> bool:
    key = next((f for f in scan(data, start, end) if f.number == 1 and f.wire_type == BYTES), None)
    return (
        key is not None
        and bytes(data[key.value : key.end]).decode(errors="replace") in _MANIFEST_KEYS
    )


def _copy_bytes(source: BinaryIO, out: BinaryIO, count: int) -> None:
    while count:
        chunk = source.read(min(count, 1 << 20))
        if not chunk:
            raise OSError(f"{source.name} became shorter while it was copied")
        out.write(chunk)
        count -= len(chunk)


def small_array(weight: TensorProto) -> np.ndarray | None:
    """Return the array of a small weight; None if the weight was not read or is not numeric."""
    if weight.raw_data == STUB_BYTES:
        return None
    try:
        array = np.asarray(numpy_helper.to_array(weight))
    except (ValueError, TypeError, KeyError):  # damaged: other rules report it
        return None
    return array if array.dtype.kind in "biuf" and array.size else None

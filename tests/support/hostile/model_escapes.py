"""Models whose external weights lead out of their folder, or are not what the model declares."""

import os
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from onnx import AttributeProto, ModelProto, NodeProto, TensorProto

from gsgen.contract.model.model_file import write_manifest
from support.models.small_models import good_rows, manifest_of, moving

CAPACITY = 64
ROWS = good_rows(CAPACITY)
"""The rows that the weights outside hold; a copy of them in an output is an escape."""
FILE = "rows.bin"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a hostile model is written.

    Attributes:
        inside: The model's folder.
        outside: A folder beside it, with a file of right weights.
    """

    inside: Path
    outside: Path

    @property
    def model(self) -> Path:
        """The model."""
        return self.inside / "model.onnx"

    @property
    def weights(self) -> Path:
        """The file of weights that a right model would have."""
        return self.inside / FILE


def model_with_rows_at(*entries: tuple[str, str], dims: tuple[int, ...] = ROWS.shape) -> ModelProto:
    """Return a generator whose rows are external data, with these entries of ``external_data``."""
    proto = moving(ROWS)
    (rows,) = (weight for weight in proto.graph.initializer if weight.name == "rows")
    detach(rows, *entries)
    rows.dims[:] = dims
    return proto


def detach(tensor: TensorProto, *entries: tuple[str, str]) -> None:
    """Make the data of a tensor external."""
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in entries:
        tensor.external_data.add(key=key, value=value)


def _save(place: Place, proto: ModelProto) -> None:
    place.model.write_bytes(proto.SerializeToString())
    write_manifest(place.model, manifest_of(CAPACITY), place.model)


def _at(*entries: tuple[str, str]) -> Callable[[Place], None]:
    """A model whose external data has these entries; ``{outside}`` stands for that folder."""

    def write(place: Place) -> None:
        filled = [(key, value.replace("{outside}", str(place.outside))) for key, value in entries]
        _save(place, model_with_rows_at(*filled))

    return write


def _link(*links: tuple[str, str], location: str = FILE) -> Callable[[Place], None]:
    """A model in whose folder there are symbolic links."""

    def write(place: Place) -> None:
        _save(place, model_with_rows_at(("location", location)))
        for name, target in links:
            path = place.inside / name
            path.parent.mkdir(exist_ok=True)
            path.symlink_to(target.replace("{outside}", str(place.outside)))

    return write


def _right_file(*entries: tuple[str, str], size: int = ROWS.nbytes) -> Callable[[Place], None]:
    """A model with a file of weights beside it, whose entries do not fit."""

    def write(place: Place) -> None:
        place.weights.write_bytes(ROWS.tobytes()[:size])
        _save(place, model_with_rows_at(("location", FILE), *entries))

    return write


def _hard_link(place: Place) -> None:
    _save(place, model_with_rows_at(("location", FILE)))
    place.weights.hardlink_to(place.outside / FILE)


def _pipe(place: Place) -> None:
    _save(place, model_with_rows_at(("location", FILE)))
    os.mkfifo(place.weights)


def _socket(place: Place) -> None:
    _save(place, model_with_rows_at(("location", "s")))
    folder = os.open(place.inside, os.O_RDONLY)
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(f"/proc/self/fd/{folder}/s")  # the path of a socket may have 107 bytes only
    os.close(folder)


def _folder(place: Place) -> None:
    _save(place, model_with_rows_at(("location", FILE)))
    place.weights.mkdir()


def _address_in_memory(place: Place) -> None:
    """ONNX Runtime takes this name for an address of its own process."""
    path = place.inside / "*" / "_ORT_MEM_ADDR_" / "*"
    path.parent.mkdir(parents=True)
    path.write_bytes(bytes(1 << 16))
    _save(place, model_with_rows_at(("location", "*/_ORT_MEM_ADDR_/*"), ("offset", "4096")))


def _huge_shape(place: Place) -> None:
    place.weights.write_bytes(ROWS.tobytes())
    _save(place, model_with_rows_at(("location", FILE), dims=(1 << 40, 10)))


def _in_attribute(place: Place) -> None:
    proto = moving(ROWS)
    (rows,) = (weight for weight in proto.graph.initializer if weight.name == "rows")
    value = TensorProto(name="rows", data_type=rows.data_type, dims=rows.dims)
    detach(value, ("location", f"../{place.outside.name}/{FILE}"))
    proto.graph.initializer.remove(rows)
    constant = NodeProto(op_type="Constant", output=["rows"])
    constant.attribute.append(AttributeProto(name="value", type=AttributeProto.TENSOR, t=value))
    proto.graph.node.insert(0, constant)
    _save(place, proto)


def _linked_model(place: Place) -> None:
    """The model is a link, and the weights a link to another folder than that of its real file."""
    models = place.outside / "models"
    models.mkdir()
    (models / "blob").write_bytes(model_with_rows_at(("location", FILE)).SerializeToString())
    write_manifest(models / "blob", manifest_of(CAPACITY), models / "blob")
    place.model.symlink_to(models / "blob")
    place.weights.symlink_to(place.outside / FILE)


ESCAPES: dict[str, Callable[[Place], None]] = {
    "a path through the parent": _at(("location", f"../outside/{FILE}")),
    "a path through a folder and back": _at(("location", f"a/../../outside/{FILE}")),
    "a path with backslashes": _at(("location", f"..\\outside\\{FILE}")),
    "an absolute path": _at(("location", f"{{outside}}/{FILE}")),
    "a device without end": _at(("location", "/dev/zero")),
    "a file of the kernel": _at(("location", "/proc/self/environ")),
    "a drive of Windows": _at(("location", f"C:\\{FILE}")),
    "a drive without a root": _at(("location", f"C:{FILE}")),
    "a share of Windows": _at(("location", f"\\\\server\\share\\{FILE}")),
    "a link to a file": _link((FILE, f"../outside/{FILE}")),
    "a link by an absolute path": _link((FILE, f"{{outside}}/{FILE}")),
    "a chain of links": _link(("b", f"../outside/{FILE}"), (FILE, "b")),
    "a link to a device": _link((FILE, "/dev/zero")),
    "a link to standard input": _link((FILE, "/dev/stdin")),
    "a link to a folder": _link(("d", "../outside"), location=f"d/{FILE}"),
    "a link to the parent": _link(("d", ".."), location=f"d/outside/{FILE}"),
    "a link in a folder": _link(("d/e", "../../outside"), location=f"d/e/{FILE}"),
    "links in a circle": _link((FILE, "b"), ("b", FILE)),
    "a link to nothing": _link((FILE, "nothing")),
    "a linked model, weights elsewhere": _linked_model,
    "a hard link": _hard_link,
    "a pipe": _pipe,
    "a socket": _socket,
    "a folder": _folder,
    "no file": _at(("location", FILE)),
    "no name": _at(("location", "")),
    "the folder itself": _at(("location", ".")),
    "a name with a zero byte": _at(("location", f"{FILE}\0.txt")),
    "a name of 5,000 letters": _at(("location", "x" * 5000)),
    "an address in memory": _address_in_memory,
    "two locations, the second outside": _right_file(("location", f"../outside/{FILE}")),
    "two locations, the first outside": _at(
        ("location", f"../outside/{FILE}"), ("location", "gone.bin")
    ),
    "a file cut off": _right_file(size=ROWS.nbytes - 1),
    "an empty file": _right_file(size=0),
    "an offset beyond the end": _right_file(("offset", "4096")),
    "an offset below zero": _right_file(("offset", "-4")),
    "an offset with an underscore": _right_file(("offset", "1_0")),
    "a length beyond the end": _right_file(("length", "99999999999999")),
    "a length of another weight": _right_file(("length", "40")),
    "a shape beyond any file": _huge_shape,
    "in an attribute": _in_attribute,
}
"""What it does → writes ``model.onnx`` into the folder ``inside``, beside ``outside``."""


def escape_places(folder: Path) -> Iterator[tuple[str, Place]]:
    """Write all hostile models, each into a folder of its own."""
    for number, name in enumerate(ESCAPES):
        yield name, write_escape(folder / str(number), name)


def write_escape(folder: Path, name: str) -> Place:
    """Write one hostile model, with right weights outside of its folder."""
    place = Place(folder / "inside", folder / "outside")
    place.inside.mkdir(parents=True)
    place.outside.mkdir()
    (place.outside / FILE).write_bytes(ROWS.tobytes())
    ESCAPES[name](place)
    return place


COMMANDS: dict[str, tuple[str, ...]] = {
    "inspect": ("model.onnx",),
    "validate": ("model.onnx",),
    "conformance": ("model.onnx",),
    "repro": ("model.onnx", "--rule", "GV001"),
    "card": ("model.onnx", "-o", "out/a.md"),
    "diff": ("model.onnx", "model.onnx"),
    "fix": ("model.onnx", "--rename", "-o", "out/a.onnx"),
    "rewrite": ("model.onnx", "-o", "out/a.onnx"),
    "float16": ("model.onnx", "-o", "out/a.onnx"),
    "references": ("model.onnx", "-o", "out/a.onnx"),
    "vectors": ("model.onnx", "--into", "out", "-o", "out/a.onnx"),
    "render": ("model.onnx", "-o", "out/a.png", "--width", "32", "--height", "32"),
    "render --post": ("scene.ply", "--post", "model.onnx", "-o", "out/a.png", "--width", "32"),
    "view": ("model.onnx",),
    "bake": ("model.onnx", "-o", "out/a.ply"),
    "bench": ("model.onnx",),
    "bench-render": ("model.onnx", "--width", "32", "--height", "32"),
    "tiles build": ("scene.ply", "--neural", "model.onnx", "-o", "out/tiles"),
}
"""Command → its arguments, which are run in the folder of a model ``model.onnx``."""

REPORTING = frozenset(list(COMMANDS)[:6])
"""Commands whose result is a report, of any length, also on a model that breaks a rule."""


def command_words(name: str) -> list[str]:
    """Return the words of a command's line, without the program."""
    first, *options = name.split()
    words = [first, *(word for word in options if not word.startswith("-"))]
    return [*words, *COMMANDS[name]]


def has_weights_of(folder: Path) -> bool:
    """Return whether a file that a command wrote holds a row of the weights outside."""
    rows = [ROWS[:1].tobytes(), ROWS[:1].astype("f2").tobytes()]
    files = [path for path in folder.rglob("*") if path.is_file()]
    return any(row in path.read_bytes() for path in files for row in rows)

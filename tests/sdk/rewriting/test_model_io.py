"""Weights go where they should, and the model that was saved is as it was."""

from pathlib import Path

import numpy as np
import onnx
import onnx_ir as ir
import pytest

from gsgen.contract.model.files_beside import FileRefused
from gsgen.sdk.rewriting.model_io import has_external_weights, load_model, save_model, weight_bytes
from support.commands import gsgen_here
from support.hostile.model_escapes import FILE, ROWS, detach, write_escape
from support.models.small_models import manifest_of, moving, save
from support.passes import parsed


def model_of(floats: int) -> ir.Model:
    """x + w, where w also stands in a subgraph as another weight."""
    model = parsed(
        f"g (float[{floats}] x, bool c) => (float[{floats}] y) "
        f"<float[{floats}] w = {{{', '.join(['0.5'] * floats)}}}> "
        "{ s = Add (x, w) y = If (c) "
        f"<then_branch = t () => (float[{floats}] a) <float[{floats}] v = "
        f"{{{', '.join(['2'] * floats)}}}> {{ a = Mul (s, v) }}, "
        f"else_branch = e () => (float[{floats}] b) {{ b = Identity (s) }}> }}"
    )
    return model


def weights(model: ir.Model) -> dict[str, np.ndarray]:
    return {
        name: value.const_value.numpy()
        for graph in model.graphs()
        for name, value in graph.initializers.items()
    }


@pytest.mark.parametrize(("floats", "is_external"), [(64, False), (65, True)])
def test_small_weights_stay_in_the_model(tmp_path: Path, floats: int, is_external: bool) -> None:
    result = model_of(floats)
    save_model(result, tmp_path / "m.onnx", external_weights=True)
    assert (tmp_path / "m.onnx.data").exists() == is_external
    read = ir.load(tmp_path / "m.onnx")
    assert has_external_weights(read) == is_external
    assert weight_bytes(read) == 2 * 4 * floats
    for name, value in weights(result).items():
        np.testing.assert_array_equal(weights(read)[name], value)
    onnx.checker.check_model(tmp_path / "m.onnx", full_check=True)


@pytest.mark.parametrize("is_external", [False, True])
def test_saving_leaves_a_model_as_it_was(tmp_path: Path, is_external: bool) -> None:
    save_model(model_of(100), tmp_path / "m.onnx", external_weights=True)
    read = ir.load(tmp_path / "m.onnx")
    before = [value.const_value for graph in read.graphs() for value in graph.initializers.values()]
    save_model(read, tmp_path / "again.onnx", external_weights=is_external)
    after = [value.const_value for graph in read.graphs() for value in graph.initializers.values()]
    assert all(a is b for a, b in zip(before, after, strict=True))
    assert has_external_weights(ir.load(tmp_path / "again.onnx")) == is_external


def test_a_model_that_cannot_be_saved_is_as_it_was_too(tmp_path: Path) -> None:
    save_model(model_of(100), tmp_path / "m.onnx", external_weights=True)
    read = ir.load(tmp_path / "m.onnx")
    with pytest.raises(OSError, match="No such file"):
        save_model(read, tmp_path / "no" / "again.onnx")
    assert has_external_weights(read)


@pytest.mark.parametrize("name", ["a link to a file", "a pipe", "a file cut off", "no file"])
def test_a_model_whose_weights_escape_is_not_loaded(tmp_path: Path, name: str) -> None:
    place = write_escape(tmp_path, name)
    with pytest.raises(FileRefused, match=FILE):
        load_model(place.model)


@pytest.mark.parametrize("is_external", [False, True])
@pytest.mark.parametrize("dtype", [onnx.TensorProto.UNDEFINED, onnx.TensorProto.STRING, 77])
@pytest.mark.parametrize("command", ["fix --rename", "float16", "rewrite"])
def test_a_weight_whose_bytes_cannot_be_counted_is_refused_in_a_line(
    tmp_path: Path, command: str, dtype: int, is_external: bool
) -> None:
    path, proto = tmp_path / "m.onnx", moving(ROWS)
    odd = onnx.TensorProto(name="odd", data_type=dtype, dims=[4], raw_data=bytes(16))
    if is_external:
        (tmp_path / FILE).write_bytes(ROWS.tobytes())
        detach(odd, ("location", FILE))
    proto.graph.initializer.append(odd)
    save(path, proto, manifest_of(len(ROWS)))
    ran = gsgen_here(*command.split(), path, "-o", tmp_path / "copy.onnx")
    assert ran.code in (0, 1, 4)  # texts as raw data are dropped by some, as no node reads them
    assert "Traceback" not in ran.err


@pytest.mark.parametrize("command", ["fix", "float16"])
def test_a_copy_of_a_model_in_a_cache_of_links_has_its_weights(
    tmp_path: Path, command: str
) -> None:
    (tmp_path / "blobs").mkdir()
    (tmp_path / "snapshot").mkdir()
    place = write_escape(tmp_path / "a", "no file")
    place.model.rename(tmp_path / "blobs" / "aa11")
    (tmp_path / "blobs" / "bb22").write_bytes(ROWS.tobytes())
    (tmp_path / "snapshot" / "model.onnx").symlink_to("../blobs/aa11")
    (tmp_path / "snapshot" / FILE).symlink_to("../blobs/bb22")
    words = ["--rename"] if command == "fix" else []
    ran = gsgen_here(command, "model.onnx", *words, "-o", "../copy.onnx", cwd=tmp_path / "snapshot")
    assert ran.code == 0, ran.err
    copy = weights(load_model(tmp_path / "copy.onnx"))
    assert any(np.allclose(array, ROWS, atol=1e-3) for array in copy.values() if array.size > 600)


def test_a_model_by_its_bare_name_is_contained_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Onnx-ir checks no path if the folder of the model's name is empty."""
    place = write_escape(tmp_path, "a path through the parent")
    monkeypatch.chdir(place.inside)
    with pytest.raises(FileRefused, match="leads out of the model's folder"):
        load_model(Path("model.onnx"))

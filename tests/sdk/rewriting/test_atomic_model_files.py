"""What commands write stands where it was asked for, and is as good as what they read."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.validator import validate
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.exporting.repair import RepairRequest, repair
from gsgen.sdk.float16.convert_model import write_float16


def test_folder_as_output_file_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(GsgenError, match="is a folder, expected a file to write") as caught,
        atomic_write(tmp_path),
    ):
        pytest.fail("no work is done for it")
    assert f"such as {tmp_path / 'model.onnx'}" in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_folder_created_meanwhile_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    draft = atomic_write(path)
    draft.__enter__().touch()
    path.mkdir()
    with pytest.raises(GsgenError, match="cannot be written"):
        draft.__exit__(None, None, None)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("name", "known"), [("pose_of_open_size", "J"), ("drift", "none")])
def test_a_size_for_no_dimension_is_refused(tmp_path: Path, name: str, known: str) -> None:
    with pytest.raises(UnknownName) as caught:
        repair(find(name).write(tmp_path), tmp_path / "m.onnx", RepairRequest(sizes={"Q": 3}))
    assert str(caught.value) == f"--size: unknown dimension 'Q'\n  Known: {known}."
    assert not (tmp_path / "m.onnx").exists()


def test_small_weights_in_another_file_come_into_the_model(tmp_path: Path) -> None:
    source = find("weights_beside").write(tmp_path)
    target = tmp_path / "elsewhere" / "fixed.onnx"
    done = repair(source, target, RepairRequest(rename=True))
    assert done.after.verdict == "conforms"
    assert [file.name for file in target.parent.iterdir()] == ["fixed.onnx"]
    assert validate(target).findings == ()


def test_a_copy_does_not_replace_the_weights_of_its_source(tmp_path: Path) -> None:
    source = find("weights_beside").write(tmp_path)
    weights = tmp_path / "weights_beside.bin"
    content = weights.read_bytes()
    for write in (repair, write_float16):
        with pytest.raises(ConfigInvalid, match=r"would replace weights_beside\.bin"):
            write(source, weights)
    assert weights.read_bytes() == content


@pytest.mark.parametrize(("name", "channels"), [("still_sh0", 3), ("still_sh2", 27)])
def test_harmonics_that_would_not_fill_words_stay_float32(
    tmp_path: Path, name: str, channels: int
) -> None:
    source, target = find(name).write(tmp_path), tmp_path / "half.onnx"
    with pytest.raises(RewriteFailed, match=rf"{channels} channels of SH(.|\n)*--keep-outputs"):
        write_float16(source, target)
    assert not target.exists()
    write_float16(source, target, outputs=False)
    assert validate(target).findings == ()


@pytest.mark.parametrize("name", ["still_sh1", "still_sh3", "still_rgb"])
def test_rows_of_float16_fill_words(tmp_path: Path, name: str) -> None:
    write_float16(find(name).write(tmp_path), tmp_path / "half.onnx")
    assert validate(tmp_path / "half.onnx").findings == ()

"""The gate to files that a model names: what it refuses, and the links that it follows."""

import os
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.model.files_beside import FileRefused, find_contained_file, require_loadable
from gsgen.contract.model.model_file import write_manifest
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.hostile.model_escapes import (
    CAPACITY,
    ESCAPES,
    FILE,
    ROWS,
    model_with_rows_at,
    write_escape,
)
from support.models.small_models import manifest_of, save_moving

STATIC = Settings(level=Level.STATIC)


def write_right_model(path: Path, location: str = FILE) -> Path:
    """Write a model whose rows lie in a file that is yet to be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model_with_rows_at(("location", location)).SerializeToString())
    write_manifest(path, manifest_of(CAPACITY), path)
    return path


def drawn_rows(path: Path) -> np.ndarray:
    """Return the rows that the sandbox computes at time zero."""
    probes = [Probe(label="zero", inputs={"time": np.zeros(1, np.float32)})]
    with execute(path, ["gaussians"], probes, Limits()) as execution:
        assert execution.fault is None
        return np.array(execution.samples[0].outputs["gaussians"])


@pytest.mark.parametrize("name", ESCAPES)
def test_weights_that_escape_are_refused_before_any_is_read(tmp_path, name):
    escape_case = write_escape(tmp_path, name)
    with pytest.raises(FileRefused) as refused:
        require_loadable(escape_case.model)
    assert str(escape_case.model) in str(refused.value)
    assert "GS001" in {finding.rule for finding in validate(escape_case.model, STATIC).findings}


@pytest.mark.parametrize("name", ["a path through the parent", "a pipe"])
def test_no_child_is_started_for_weights_that_escape(tmp_path, name):
    escape_case = write_escape(tmp_path, name)
    with execute(escape_case.model, ["gaussians"], [], Limits()) as execution:
        assert execution.fault is not None
        assert execution.fault.stage == "load"
        assert FILE in execution.fault.message
        assert execution.events == ()


def test_weights_in_a_folder_below_and_links_within_it_are_read(tmp_path):
    path = write_right_model(tmp_path / "model.onnx", "weights.bin")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / FILE).write_bytes(ROWS.tobytes())
    (tmp_path / "weights.bin").symlink_to(f"deep/{FILE}")
    assert validate(path, Settings(level=Level.VALUES)).verdict == "conforms"
    np.testing.assert_array_equal(drawn_rows(path), ROWS)


@pytest.mark.parametrize("depth", ["", "onnx"])
def test_a_cache_that_stores_files_by_digest_is_read(tmp_path, depth):
    """In such a cache the model and its weights are links to files of one folder."""
    blobs, snapshot = tmp_path / "blobs", tmp_path / "snapshots" / "main" / depth
    write_right_model(blobs / "aa11")
    (blobs / "bb22").write_bytes(ROWS.tobytes())
    snapshot.mkdir(parents=True)
    up = os.path.relpath(blobs, snapshot)
    (snapshot / "model.onnx").symlink_to(f"{up}/aa11")
    (snapshot / FILE).symlink_to(f"{up}/bb22")
    report = validate(snapshot / "model.onnx", Settings(level=Level.VALUES))
    assert report.verdict == "conforms"
    assert report.external_size == ROWS.nbytes
    np.testing.assert_array_equal(drawn_rows(snapshot / "model.onnx"), ROWS)


def test_a_link_to_a_model_finds_the_weights_beside_the_real_file(tmp_path):
    path = write_right_model(tmp_path / "releases" / "model.onnx")
    (path.parent / FILE).write_bytes(ROWS.tobytes())
    (tmp_path / "latest.onnx").symlink_to(path)
    assert validate(tmp_path / "latest.onnx", Settings(level=Level.VALUES)).verdict == "conforms"
    np.testing.assert_array_equal(drawn_rows(tmp_path / "latest.onnx"), ROWS)


def test_a_name_that_is_not_utf8_makes_no_model_invalid(tmp_path):
    path = save_moving(tmp_path / os.fsdecode(b"caf\xe9.onnx"), ROWS)
    assert validate(path, Settings(level=Level.VALUES)).verdict == "conforms"


def test_a_name_that_is_not_utf8_beside_external_weights_is_said(tmp_path):
    path = write_right_model(tmp_path / os.fsdecode(b"caf\xe9.onnx"))
    (tmp_path / FILE).write_bytes(ROWS.tobytes())
    with pytest.raises(ModelUnreadable, match="not UTF-8"):
        require_loadable(path)


def test_a_file_of_two_names_is_refused_with_both_counts(tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "b.png").hardlink_to(tmp_path / "a.png")
    with pytest.raises(FileRefused, match="2 names"):
        find_contained_file(tmp_path / "model.onnx", "a.png")


@pytest.mark.parametrize(
    ("location", "name", "words"),
    [
        ("weights.bin", "Weights.bin", "'Weights.bin' is there, which differs in case"),
        ("my%20weights.bin", "my weights.bin", "percent-encoded, and 'my weights.bin' is there"),
        ("data\\weights.bin", "data/weights.bin", "backslashes, and 'data/weights.bin' is there"),
        ("weights.bin", "other.bin", "no such file (weight"),
    ],
)
def test_a_near_name_of_missing_weights_is_said(tmp_path, location, name, words):
    path = write_right_model(tmp_path / "a.onnx", location)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_bytes(ROWS.tobytes())
    (finding,) = validate(path, STATIC).findings
    assert finding.rule == "GS001"
    assert words in finding.message


@pytest.mark.parametrize("padding", [0, 1 << 12])
def test_a_pointer_of_git_lfs_is_named_also_if_it_is_long_enough(tmp_path, padding):
    path = write_right_model(tmp_path / "a.onnx")
    pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + bytes(padding)
    (tmp_path / FILE).write_bytes(pointer)
    (finding,) = validate(path, STATIC).findings
    assert "is a git LFS pointer" in finding.message
    with pytest.raises(FileRefused, match="git lfs pull"):
        require_loadable(path)

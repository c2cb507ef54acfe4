"""Checkpoints with a damaged file, of every method: read, or refused by its name; never a crash."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.reference_plugins.anchors.anchor_checkpoint import read_anchors
from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import is_script_archive
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    write_hexplane,
    write_scaffold,
)
from plugins.loading.method_runs import METHODS

MUTANTS = 60


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut a file, overwrite bytes anywhere or in front, or insert and drop some."""
    result = bytearray(data)
    kind, start = rng.integers(0, 5), int(rng.integers(0, len(result)))
    if kind == 0:
        return bytes(result[:start])
    if kind == 1:
        return rng.bytes(int(rng.integers(0, 100)))
    if kind == 2:
        for position in rng.integers(0, len(result), 12):
            result[position] = rng.integers(0, 256)
    elif kind == 3:
        result[start % min(1500, len(result))] = rng.integers(0, 256)
    else:
        result[start : start + int(rng.integers(0, 200))] = rng.bytes(int(rng.integers(0, 50)))
    return bytes(result)


@pytest.mark.parametrize("method", METHODS)
def test_damage_is_refused_by_the_name_of_the_file(method: str, tmp_path: Path) -> None:
    write, read = METHODS[method]
    folder, rng = write(tmp_path / "run"), np.random.default_rng(7)
    refused: list[CheckpointInvalid] = []
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    for index in range(MUTANTS):
        path = files[index % len(files)]
        whole = path.read_bytes()
        path.write_bytes(damaged(whole, rng))
        try:
            read(folder)
        except CheckpointInvalid as error:
            refused.append(error)
        finally:
            path.write_bytes(whole)
    assert len(refused) > MUTANTS / 2
    assert all(str(folder) in error.where for error in refused)
    read(folder)


@pytest.mark.filterwarnings("error")
def test_other_protocols_of_pickle_are_read_without_a_word(tmp_path: Path) -> None:
    folder = write_hexplane(tmp_path, HexPlaneOptions(count=4))
    (path,) = folder.rglob("deformation.pth")
    torch.save(torch.load(path, weights_only=True), path, pickle_protocol=3)
    read_hexplanes(folder)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"PK\x01\x02", b"PK\x01\x09"),  # an entry of the central directory
        (b"data.pkl", b"\xffata.pkl"),  # a name that is no UTF-8
        (b"PK\x06\x07", b"PK\x06\x07\x05"),  # an archive on five disks
    ],
)
def test_an_archive_that_cannot_be_listed_is_refused(
    old: bytes, new: bytes, tmp_path: Path
) -> None:
    folder = write_scaffold(tmp_path, AnchorOptions(anchors=3))
    (path,) = folder.rglob("cov_mlp.pt")
    data = bytearray(path.read_bytes())
    start = data.rindex(old)
    data[start : start + len(new)] = new
    path.write_bytes(data)
    assert is_script_archive(path)
    with pytest.raises(CheckpointInvalid, match=r"cov_mlp\.pt: cannot be read"):
        read_anchors(folder)

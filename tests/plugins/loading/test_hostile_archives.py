"""Pickles and TorchScript archives of an attacker: each is read as data, or refused in a message."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats.shared.errors import SizeExceeded
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.states import read_script_state
from support.hostile.pickles import PICKLES, write_pickle
from support.hostile.random_bytes import run_checked
from support.hostile.scripts import SCRIPTS, views_of_one_storage, write_module, write_script

# Read as data: what would be harmful in them has no effect here.
READ = {
    "a dtype of objects by state": [0, 0, 0, 0],
    "a dtype whose state is a text": [0, 0, 0, 0],
    "an index of the memo of 4 billion": None,
    "a frame of 8 exabytes": None,
}
LISTS_ARE_NOT_TENSORS = {
    *("tuples shared 2⁴⁰ times", "lists shared 2⁴⁰ times", "dicts shared 2⁴⁰ times")
}
ONE_TENSOR = "100,000 names of one tensor"


@pytest.mark.parametrize("name", sorted(PICKLES.keys() - READ))
def test_a_hostile_pickle_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_pickle(tmp_path, name)
    tracemalloc.start()
    with pytest.raises(CheckpointInvalid) as refused:
        read_array_pickle(path, ["x"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100e6
    assert "\n" not in refused.value.message
    assert list(tmp_path.iterdir()) == [path]  # no code ran


@pytest.mark.parametrize("name", READ)
def test_a_pickle_that_is_harmless_as_data_is_read(tmp_path: Path, name: str) -> None:
    arrays = read_array_pickle(write_pickle(tmp_path, name), ["x"])
    expected = READ[name]
    assert arrays.keys() == (set() if expected is None else {"x"})
    if expected is not None:
        np.testing.assert_array_equal(arrays["x"], expected)


@pytest.mark.parametrize("name", sorted(SCRIPTS.keys() - LISTS_ARE_NOT_TENSORS - {ONE_TENSOR}))
def test_a_script_archive_without_end_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(CheckpointInvalid, match="cannot be read: "):
        read_script_state(write_script(tmp_path, name))


@pytest.mark.parametrize("name", sorted(LISTS_ARE_NOT_TENSORS))
def test_a_script_archive_of_shared_lists_has_no_tensors(tmp_path: Path, name: str) -> None:
    assert read_script_state(write_script(tmp_path, name)) == {}


def test_names_of_one_tensor_share_its_numbers(tmp_path: Path) -> None:
    state = read_script_state(write_script(tmp_path, ONE_TENSOR))
    assert len(state) == 100_000
    assert len({tensor.data_ptr() for tensor in state.values()}) == 1


def test_views_of_one_storage_take_no_more_than_the_file(tmp_path: Path) -> None:
    path = write_script(tmp_path, "3,000 views of one storage")
    with pytest.raises(CheckpointInvalid, match="numbers together") as refused:
        read_script_state(path)
    assert isinstance(refused.value.__cause__, SizeExceeded)


def test_parts_of_one_storage_are_read(tmp_path: Path) -> None:
    """Networks that were trained on several GPUs keep all weights in one storage."""
    pickle = views_of_one_storage(count=3, length=4, step=4, total=12)
    numbers = np.arange(12, dtype="<f4")
    state = read_script_state(write_module(tmp_path / "net.pt", pickle, numbers.tobytes()))
    assert state["w0"].tolist() == [0, 1, 2, 3]
    assert state["w2"].tolist() == [8, 9, 10, 11]


@pytest.mark.parametrize("kind", ["pickles", "headers"])
def test_random_files_neither_crash_nor_damage_memory(kind: str) -> None:
    ended = run_checked(kind, 300)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.startswith(f"300 {kind}, ")


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["pickles", "headers"])
def test_20_000_random_files_neither_crash_nor_damage_memory(kind: str) -> None:
    ended = run_checked(kind, 20_000, seed=1)
    assert ended.returncode == 0, ended.stderr

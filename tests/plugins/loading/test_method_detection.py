"""A run of one method, given to the plugin of another."""

from pathlib import Path

import pytest

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import last_iteration
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman
from gsgen.reference_plugins.people.r3_avatar_checkpoint import read_r3
from gsgen.reference_plugins.synthetic import HexPlaneOptions, write_hexplane
from gsgen.sdk.plugins.plugin import installed_plugins
from plugins.loading.method_runs import METHODS

# The files of these are like those of no other method.
DISTINCT_METHODS = ("gart", "lgm", "lhm", "rotor-4dgs", "splatter-image")
SHARED_METHODS = {name: both for name, both in METHODS.items() if name not in DISTINCT_METHODS}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    runs_folder = tmp_path_factory.mktemp("runs")
    folders = {name: write(runs_folder / name) for name, (write, _) in SHARED_METHODS.items()}
    # Training of R3-Avatar writes the files of GauHuman, too; they are not enough for it.
    for subfolder in ("point_cloud", "mlp_ckpt"):
        target = folders["r3-avatar"] / subfolder
        target.symlink_to(folders["gauhuman"] / subfolder)
    return folders


@pytest.mark.parametrize("plugin", SHARED_METHODS)
def test_checkpoint_names_the_matching_plugin(plugin: str, runs: dict[str, Path]) -> None:
    read = SHARED_METHODS[plugin][1]
    read(runs[plugin])
    for name, run in runs.items():
        if name == plugin or (name == "r3-avatar" and plugin != "gauhuman"):
            continue
        with pytest.raises(CheckpointInvalid, match="is a checkpoint of") as caught:
            read(run)
        assert caught.value.hint == f"Export it with `gsgen export {name}`."


@pytest.mark.parametrize("name", SHARED_METHODS)
def test_one_plugin_recognises_a_run(name: str, runs: dict[str, Path]) -> None:
    iterations = runs[name].glob("point_cloud/iteration_*")
    recognising_plugins = {
        plugin.name
        for iteration in iterations
        for plugin in installed_plugins()
        if plugin.recognises is not None and plugin.recognises(runs[name], iteration)
    }
    assert recognising_plugins == {name}


def test_a_resume_file_of_gauhuman_is_not_taken_for_one_of_r3(runs: dict[str, Path]) -> None:
    run = runs["gauhuman"]
    (run / "chkpnt1200.pth").write_bytes(b"PK but no archive")
    assert read_gauhuman(run).nets is not None
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_r3(run, dataset="zju")


def test_the_last_iteration_is_that_of_the_highest_number(tmp_path: Path) -> None:
    run = write_hexplane(tmp_path / "run", HexPlaneOptions(count=3))
    (files,) = (run / "point_cloud").iterdir()
    files.rename(files.with_name("iteration_10000"))  # as text, 7000 is the larger one
    (run / "point_cloud/iteration_7000").mkdir()
    (run / "point_cloud/iteration_x").mkdir()
    with pytest.raises(CheckpointInvalid, match="is a checkpoint of 4DGaussians"):
        read_r3(run, dataset="zju")
    assert last_iteration(run).name == "iteration_10000"
    assert last_iteration(tmp_path) == tmp_path

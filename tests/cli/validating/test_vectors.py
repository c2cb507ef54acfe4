"""`gsgen vectors`, and what `gsgen validate` makes of what it wrote."""

import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx.backend.test import runner as onnx_runner

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import MANIFEST_KEY, open_model
from gsgen.contract.probing.test_vectors import MAX_VECTOR_SEEDS
from gsgen.contract.spec.manifest import TestVector as Vector
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.tools.recording import RecordingRefused
from gsgen.contract.tools.test_vector_files import record_vectors
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.commands import gsgen, gsgen_here


def write_fixture(folder: Path, name: str, **declared: object) -> Path:
    """Write a fixture; ``declared`` replaces fields of its manifest."""
    spec: ModelSpec = find(name).draw()
    path = folder / f"{name}.onnx"
    (spec.with_manifest(**declared) if declared else spec).write(path)
    return path


def told_of_vectors(path: Path, **settings: object) -> list[str]:
    report = validate(path, Settings(**settings))
    assert report.outcome("GM012").status in ("pass", "fail")
    return [entry.message for entry in report.findings if entry.rule == "GM012"]


def test_written_vectors_are_reproduced_until_a_weight_changes(tmp_path: Path) -> None:
    source = write_fixture(tmp_path, "drift")
    completed = gsgen("vectors", "drift.onnx", "--count", "4", cwd=tmp_path)
    assert completed.code == 0, completed.err
    result = tmp_path / "drift-vectors"
    assert "drift-vectors/test_data_set_0: all inputs zero\n" in completed.out
    assert sorted(path.name for path in result.iterdir()) == [
        "model.onnx",
        *(f"test_data_set_{index}" for index in range(4)),
    ]
    assert source.read_bytes() == write_fixture(tmp_path, "drift").read_bytes()

    good = gsgen_here("validate", result / "model.onnx", "--format", "json")
    assert good.code == 0
    report = json.loads(good.out)
    assert report["findings"] == []
    statuses = {entry["id"]: entry["status"] for entry in report["rules"]}
    assert statuses["GM012"] == "pass"

    model = onnx.load(result / "model.onnx")
    (speed,) = [entry for entry in model.graph.initializer if entry.name == "speed"]
    changed = onnx.numpy_helper.to_array(speed).copy()
    changed[3, 1] += 1e-3
    speed.CopyFrom(onnx.numpy_helper.from_array(changed, "speed"))
    onnx.save(model, result / "changed.onnx")
    failed_validation = gsgen_here("validate", "changed.onnx", cwd=result)
    assert failed_validation.out.count("GM012 warning (possible) test-vectors-reproduce") == 1
    assert failed_validation.out.count("    manifest test_vectors") == 3
    assert (
        "manifest test_vectors.0" not in failed_validation.out
    )  # while time is zero, speed is not felt
    for index in (1, 2, 3):
        assert f"manifest test_vectors.{index}: sha256" in failed_validation.out


class _Backend:
    """ONNX Runtime, as ONNX's own runner wants to have it."""

    def is_compatible(self, model: onnx.ModelProto) -> bool:
        return True

    def supports_device(self, device: str) -> bool:
        return device == "CPU"

    def prepare(self, model: onnx.ModelProto, device: str) -> SimpleNamespace:
        session = onnxruntime.InferenceSession(model.SerializeToString())
        names = [entry.name for entry in session.get_inputs()]
        return SimpleNamespace(
            run=lambda values: session.run(None, dict(zip(names, values, strict=True)))
        )


class _Runner(onnx_runner.Runner):
    """ONNX's own runner, without the tests of operators that it makes at its start."""

    def __init__(self) -> None:
        self.backend = _Backend()
        self._test_items = defaultdict(dict)
        self._test_kwargs = {}


@pytest.mark.parametrize("name", ["drift_half", "avatar", "still_sh0", "one_step_enhancer"])
def test_onnx_s_own_runner_reads_and_reproduces_them(name: str, tmp_path: Path) -> None:
    result = record_vectors(write_fixture(tmp_path, name), tmp_path / "out", count=1)
    assert len(result.vectors) == 1
    runner, folder = _Runner(), str(tmp_path / "out")
    case = SimpleNamespace(name="test_it", model_name="it", model_dir=folder, url=None)
    case.rtol = case.atol = 0
    runner._add_model_test(case, "Real")
    reproduce = runner._test_items["RealModel"]["test_it_cpu"].func
    reproduce(None)
    output = tmp_path / "out" / "test_data_set_0" / "output_0.pb"
    tensor = onnx.TensorProto.FromString(output.read_bytes())
    array = onnx.numpy_helper.to_array(tensor) + 1
    output.write_bytes(onnx.numpy_helper.from_array(array).SerializeToString())
    with pytest.raises(AssertionError):
        reproduce(None)


def test_another_seed_is_kept_and_probed(tmp_path: Path) -> None:
    model = tmp_path / "copy.onnx"
    result = record_vectors(write_fixture(tmp_path, "avatar"), tmp_path / "out", model, seed=9)
    assert result.model == model
    assert {entry.seed for entry in result.vectors} == {9}
    assert not (tmp_path / "out" / "model.onnx").exists()
    assert told_of_vectors(model) == []
    assert told_of_vectors(model, seed=9) == []
    manifest = loads(open_model(model).manifest_text or "")
    first = replace(manifest.test_vectors[1], seed=8)
    wrong = write_fixture(tmp_path, "avatar", test_vectors=(first,))
    (message,) = told_of_vectors(wrong)
    assert f"the declared {first.expected_sha256}" in message


def test_vectors_that_cannot_be_run_are_named(tmp_path: Path) -> None:
    many_vectors = tuple(
        Vector(inputs="no inputs", expected_sha256="0" * 64, seed=seed) for seed in range(1, 7)
    )
    messages = " ".join(
        told_of_vectors(write_fixture(tmp_path, "still_sh0", test_vectors=many_vectors))
    )
    assert (
        f"seed {MAX_VECTOR_SEEDS + 1}; expected {MAX_VECTOR_SEEDS} other seeds at most" in messages
    )
    unknown_vector = (Vector(inputs="noon", expected_sha256="0" * 64, seed=3),)
    document = told_of_vectors(write_fixture(tmp_path, "drift", test_vectors=unknown_vector))
    assert "no probe 'noon' with seed 3" in document[0]


def test_external_weights_and_foreign_fields_come_along(tmp_path: Path) -> None:
    spec = find("weights_beside").draw()
    studio = spec.edit_manifest(lambda document: document.update({"x-studio": {"take": 3}}))
    studio.write(tmp_path / "m.onnx")
    result = record_vectors(tmp_path / "m.onnx", tmp_path / "out", count=1)
    text = open_model(result.model).manifest_text
    assert json.loads(text or "")["x-studio"] == {"take": 3}
    assert told_of_vectors(result.model) == []


def test_a_copy_is_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights in a folder of their own are written beside their place, as the model is."""
    spec = find("weights_beside").draw()
    (retained,) = spec.extra_files.values()
    where = {name: replace(entry, location="w/c.bin") for name, entry in spec.external.items()}
    (tmp_path / "w").mkdir()
    moved = replace(spec, external=where, extra_files={"w/c.bin": retained})
    moved.write(tmp_path / "m.onnx")
    target = tmp_path / "there" / "m.onnx"
    record_vectors(tmp_path / "m.onnx", tmp_path / "out", target, count=1)
    assert told_of_vectors(target) == []
    before = {path: path.read_bytes() for path in target.parent.rglob("*.*")}
    assert sorted(path.name for path in before) == ["c.bin", "m.onnx"]

    def full(source: Path, copy: Path) -> None:
        Path(copy).write_bytes(b"half of")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gsgen.contract.tools.test_vector_files.shutil.copyfile", full)
    with pytest.raises(ConfigInvalid, match="cannot be written: No space left"):
        record_vectors(tmp_path / "m.onnx", tmp_path / "out2", target, count=1)
    assert {path: path.read_bytes() for path in target.parent.rglob("*.*")} == before


def test_unreproducible_vectors_are_refused_without_output(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for name, document in (
        ("no_manifest", "has no manifest"),
        ("count_is_int64", "breaks GO011 at output num_points"),
        ("seeded_random", "breaks GG010 at node noise"),
    ):
        with pytest.raises(RecordingRefused, match=document) as caught:
            record_vectors(find(name).write(tmp_path), out, count=1)
        assert f"{name}.onnx" in caught.value.where
        assert not out.exists()
    with pytest.raises(ConfigInvalid, match="10 test vectors, but the model has only 9 probes"):
        record_vectors(write_fixture(tmp_path, "drift"), out, count=10)


def test_stale_vector_folders_are_removed_and_link_targets_stay(tmp_path: Path) -> None:
    source, out, retained = write_fixture(tmp_path, "drift"), tmp_path / "out", tmp_path / "kept"
    retained.mkdir()
    out.mkdir()
    (retained / "mine").touch()
    (out / "test_data_set_0").touch()
    (out / "test_data_set_1").symlink_to(retained)
    with pytest.raises(ConfigInvalid, match="expected 1 or more"):
        record_vectors(source, out, count=0, force=True)
    record_vectors(source, out, count=1, force=True)
    assert sorted(path.name for path in out.iterdir()) == ["model.onnx", "test_data_set_0"]
    assert (out / "test_data_set_0" / "output_0.pb").exists()
    assert (retained / "mine").exists()


def test_standing_vectors_are_replaced_only_by_force(tmp_path: Path) -> None:
    source = write_fixture(tmp_path, "drift")
    record_vectors(source, tmp_path / "out", count=3)
    second_run = gsgen_here("vectors", source, "--into", tmp_path / "out")
    assert second_run.code == 2
    assert "the folder already holds test_data_set_0" in second_run.err
    forced_run = gsgen_here(
        "vectors", source, "--into", tmp_path / "out", "--count", "1", "--force", "--json"
    )
    (entry,) = json.loads(forced_run.out)["vectors"]
    assert entry["inputs"] == "all inputs zero"
    sets = sorted(path.name for path in (tmp_path / "out").glob("test_data_set_*"))
    assert sets == ["test_data_set_0"]
    assert gsgen_here("vectors", tmp_path / "none.onnx").code == 4


def test_the_manifest_is_the_only_thing_that_changes(tmp_path: Path) -> None:
    source = write_fixture(tmp_path, "drift")
    record_vectors(source, tmp_path, tmp_path / "new.onnx", count=1)
    before, after = onnx.load(source), onnx.load(tmp_path / "new.onnx")
    for model in (before, after):
        retained = [entry for entry in model.metadata_props if entry.key != MANIFEST_KEY]
        del model.metadata_props[:]
        model.metadata_props.extend(retained)
    assert before == after
    x = {"time": np.float32([0.5])}
    first = onnxruntime.InferenceSession(source).run(None, x)
    second = onnxruntime.InferenceSession(tmp_path / "new.onnx").run(None, x)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))

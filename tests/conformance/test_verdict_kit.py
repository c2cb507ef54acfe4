"""The verdict kit, read as a validator in another language would."""

import json
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from gsgen.conformance.fixtures import find, fixtures
from gsgen.conformance.verdict_kit import write_verdicts
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.validator import validate

_NAMES = ("drift", "opacity_is_logits", "count_is_int64", "still_rgb", "weights_beside")


def test_every_model_of_the_corpus_that_a_second_validator_can_judge_is_there(
    tmp_path: Path,
) -> None:
    index = write_verdicts(tmp_path / "kit")
    models = json.loads(index.read_text("utf-8"))["models"]
    rules = installed_rules().rules
    judged = {entry["rule"] for entry in models}
    expected = {rule.id for rule in rules.values() if rule.level <= Level.VALUES}
    assert "" in judged
    # Limits, waivers and tilesets are not a matter of one model.
    left_out = {"GS002", "GS004", "GW001"} | {id for id in expected if id.startswith("GT")}
    assert expected - judged <= left_out
    assert judged - {""} <= expected
    assert len(models) > 300
    for entry in models:
        assert (tmp_path / "kit" / entry["model"]).is_file()


def test_models_break_the_rule_beside_them_at_the_probes_beside_them(tmp_path: Path) -> None:
    examples = [find(name) for name in _NAMES]
    kit = write_verdicts(tmp_path / "kit", examples).parent
    models = json.loads((kit / "index.json").read_text("utf-8"))["models"]
    assert [Path(entry["model"]).stem for entry in models] == list(_NAMES)
    for entry, fixture in zip(models, examples, strict=True):
        report = validate(kit / entry["model"], fixture.settings)
        found = {(finding.rule, finding.severity.word) for finding in report.findings}
        assert found == ({(entry["rule"], entry["severity"])} if entry["rule"] else set())
    logits = next(entry for entry in models if entry["rule"] == "GV003")
    session = ort.InferenceSession((kit / logits["model"]).read_bytes())
    for probe in json.loads((kit / logits["probes"]).read_text("utf-8")):
        feeds = {
            name: np.array(given["values"], given["dtype"]).reshape(given["shape"])
            for name, given in probe["inputs"].items()
        }
        gaussians = session.run(["gaussians"], feeds)[0]
        assert gaussians[:, 3].min() < 0 or gaussians[:, 3].max() > 1
    assert "probes" not in models[2]  # a static rule needs no run


def test_a_folder_with_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").touch()
    with pytest.raises(ConfigInvalid, match="the output folder is not empty"):
        write_verdicts(tmp_path, fixtures()[:1])
    assert [path.name for path in tmp_path.iterdir()] == ["a"]

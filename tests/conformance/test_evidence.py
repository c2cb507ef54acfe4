"""What a failure leaves behind: a command that is enough, and a file that is not too large."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conformance.pytest_runs import write
from gsgen.conformance.evidence import EvidenceDumps, suspect_probes
from gsgen.conformance.rerun import find_probes, plan_model_runs, save_runs
from gsgen.conformance.run import run_model
from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings


def test_a_dump_that_is_too_large_is_announced_not_written(tmp_path: Path) -> None:
    (model,) = write(tmp_path, "opacity_is_logits")
    run = run_model(model, Settings(), dumps=EvidenceDumps(tmp_path / "dumps", max_bytes=10))
    (evidence,) = run.evidence.values()
    assert evidence.dump is None
    assert evidence.withheld_bytes > 10
    assert "kept only where a folder is given" in str(evidence)
    assert not (tmp_path / "dumps").exists()


def test_the_command_repeats_what_settings_say(tmp_path: Path) -> None:
    (model,) = write(tmp_path, "opacity_is_logits")
    settings = Settings(target=load_target("webgpu"), seed=3)
    limits = replace(settings.limits, seconds=7.5, memory=3 << 30)
    run = run_model(model, replace(settings, limits=limits))
    command = run.evidence["GV003"].command
    assert "--target webgpu --seed 3 --timeout 7.5 --memory 3072" in command


def test_a_probe_is_only_given_where_it_is_enough(tmp_path: Path) -> None:
    """A rule about the share of all rows may need them all."""
    write(tmp_path, "all_transparent", "time_times_zero")
    strict_settings = Settings(fail_on=Severity.WARNING)
    failed_run = run_model(tmp_path / "all_transparent.onnx", strict_settings).evidence["GV004"]
    assert "--probe" in failed_run.command
    compared = run_model(tmp_path / "time_times_zero.onnx", strict_settings).evidence["GB003"]
    assert "--probe" not in compared.command


def test_suspects_are_the_probes_that_findings_speak_of(tmp_path: Path) -> None:
    (model,) = write(tmp_path, "time_times_zero")
    strict_settings = Settings(fail_on=Severity.WARNING)
    findings = run_model(model, strict_settings).case("GB003").findings
    _, plan = plan_model_runs(model, strict_settings)
    labels = [probe.label for probe in suspect_probes(plan, findings)]
    assert any(" with the time of " in label for label in labels)
    assert suspect_probes(plan, []) == [plan.probes[1]]


def test_probes_go_by_label_or_number(tmp_path: Path) -> None:
    (model,) = write(tmp_path, "drift")
    _, plan = plan_model_runs(model, Settings())
    assert find_probes(plan.probes, "2")[0] is plan.probes[2]
    assert find_probes(plan.probes, plan.probes[2].label)[0] is plan.probes[2]
    with pytest.raises(UnknownName, match="unknown probe '999'"):
        find_probes(plan.probes, "999")


def test_names_of_tensors_do_not_steer_the_file(tmp_path: Path) -> None:
    (model,) = write(tmp_path, "drift")
    _, plan = plan_model_runs(model, Settings())
    odd = replace(plan.probes[1], inputs={"../file": np.arange(3), "file": np.arange(2)})
    save_runs(tmp_path / "a" / "x.npz", [(odd, {"a/b": np.ones(4)}), (odd, {})])
    with np.load(tmp_path / "a" / "x.npz") as arrays:
        assert set(arrays) == {
            *("probe", "input.../file", "input.file", "output.a/b"),
            *("2.probe", "2.input.../file", "2.input.file"),
        }
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["x.npz"]

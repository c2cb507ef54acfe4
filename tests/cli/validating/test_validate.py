import json
from pathlib import Path

import pytest

from support.commands import gsgen, gsgen_here


def test_a_good_model_conforms(good: Path) -> None:
    completed = gsgen("validate", good)
    assert completed.code == 0
    assert "conforms: " in completed.out
    assert completed.err == ""


def test_broken_model_exits_1_with_location_and_hint(nan: Path) -> None:
    completed = gsgen_here("validate", nan)
    assert completed.code == 1
    assert "GV001 error rows-finite" in completed.out
    assert "output gaussians: 1 of 40 rows (2.5 %), first row 7" in completed.out
    assert "hint: " in completed.out
    assert "Traceback" not in completed.out + completed.err


def test_json_has_the_same_verdict(nan: Path) -> None:
    completed = gsgen_here("validate", nan, "--format", "json")
    document = json.loads(completed.out)
    assert document["verdict"] == "invalid"
    assert [finding["rule"] for finding in document["findings"]] == ["GV001"]
    assert document["findings"][0]["stats"]["examples"][0]["row"] == 7
    statuses = {rule["status"] for rule in document["rules"]}
    assert statuses <= {"pass", "fail", "skipped", "not-applicable"}


def test_output_goes_to_a_file_whole(nan: Path, tmp_path: Path) -> None:
    target = tmp_path / "reports" / "report.json"
    target.parent.mkdir()
    completed = gsgen_here("validate", nan, "--format", "json", "-o", target)
    assert completed.code == 1
    written, verdict = completed.out.splitlines()
    assert written == f"wrote {target}"
    assert verdict.startswith(f"{nan}: invalid")
    assert json.loads(target.read_text())["verdict"] == "invalid"
    assert [path.name for path in target.parent.iterdir()] == ["report.json"]


def test_several_models_give_several_reports(good: Path, nan: Path) -> None:
    completed = gsgen_here("validate", good, nan, "--format", "json")
    assert completed.code == 1
    assert [r["verdict"] for r in json.loads(completed.out)["reports"]] == ["conforms", "invalid"]


def test_an_unreadable_file_exits_4_and_the_others_are_still_judged(
    good: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "empty.onnx"
    empty.touch()
    completed = gsgen_here("validate", empty, good)
    assert completed.code == 4
    assert f"gsgen: {empty}: is empty" in completed.err
    assert "conforms" in completed.out


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ((), 0),
        (("--fail-on", "warning"), 1),
        (("--fail-on", "warning", "--ignore", "GV004"), 0),
        (("--fail-on", "warning", "--ignore", "mostly-visible,GM001"), 0),
        (("--severity", "GV004=error"), 1),
        (("--severity", "gv004=error", "--severity", "GV004=info"), 0),
        (("--fail-on", "info", "--severity", "GV004=info"), 1),
    ],
)
def test_fail_on_sets_the_failing_severity(dim: Path, options: tuple[str, ...], code: int) -> None:
    assert gsgen_here("validate", dim, *options).code == code


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--ignore", "GV999"), "--ignore: unknown rule 'GV999'"),
        (("--severity", "GV004=fatal"), "unknown severity 'fatal'"),
        (("--severity", "GV004"), "Write it as GV004=error."),
        (("--severity", "GV004:warning"), "Write it as GV004=warning."),
        (("--level", "behavior"), "Did you mean 'behaviour'?"),
        (("--target", "webgpuu"), "Did you mean 'webgpu'?"),
        (("--target", "webgpu@9"), "has version 1.0, not 9"),
        (("--fail-on", "never"), "unknown severity 'never'"),
        (("--config", "nowhere.toml"), "nowhere.toml: the settings file cannot be read"),
        (("--format", "yaml"), "yaml"),
        (("--frobnicate",), "No such option"),
    ],
)
def test_a_wrong_option_exits_2_and_names_itself(
    good: Path, options: tuple[str, ...], words: str
) -> None:
    completed = gsgen_here("validate", good, *options)
    assert completed.code == 2
    assert words in completed.err
    assert "Traceback" not in completed.err


def test_an_unknown_command_names_the_nearest() -> None:
    completed = gsgen_here("validat")
    assert completed.code == 2
    assert completed.err == "gsgen: unknown command 'validat'\n  Did you mean 'validate'?\n"


def test_configuration_is_found_in_the_folder_and_the_command_line_wins(dim: Path) -> None:
    (dim.parent / "gsgen.toml").write_text('[validate]\nfail_on = "warning"\n')
    assert gsgen_here("validate", dim, cwd=dim.parent).code == 1
    assert gsgen_here("validate", dim, "--fail-on", "error", cwd=dim.parent).code == 0
    (dim.parent / "gsgen.toml").write_text('[validate]\nfail-on = "warning"\n')
    completed = gsgen_here("validate", dim, cwd=dim.parent)
    assert completed.code == 2
    assert "unknown key 'fail-on'" in completed.err
    assert "'fail_on'" in completed.err


def test_levels_that_cannot_run_are_named_and_do_not_pass_in_silence(good: Path) -> None:
    none = {"WGPUPY_WGPU_ADAPTER_NAME": "an adapter that is not here"}
    completed = gsgen_here("validate", good, "--level", "render", env=none)
    assert completed.code == 0
    assert "level render did not run" in completed.out
    assert "no graphics adapter" in completed.out


def test_a_model_without_manifest_is_judged_all_the_same(good: Path) -> None:
    import onnx

    model = onnx.load(good)
    del model.metadata_props[:]
    onnx.save(model, good)
    completed = gsgen_here("validate", good)
    assert completed.code == 1
    assert "GM001 error manifest-present" in completed.out
    assert "GV003" not in completed.out  # values are judged by what is inferred, and hold

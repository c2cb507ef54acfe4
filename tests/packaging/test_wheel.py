"""The wheel, installed where nothing else is: a validator without torch and without wgpu."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from importlib.metadata import distribution
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from support.commands import ROOT
from support.reports.pages import DOCS, blocks
from support.web.packages import package

pytestmark = pytest.mark.slow


ACME = Path(__file__).parent / "acme"
PROGRAMS = DOCS / "guides/use-it-from-python.md"
_DOTTED = re.compile(r"\bgsgen(?:\.\w+)+")
_IMPORT_PATTERN = re.compile(r"from (gsgen[.\w]*) import (?:(\w[^\n(]*)|\(([^)]*)\))")
Acme = Callable[..., "subprocess.CompletedProcess[str]"]


def run(*command: str | Path, cwd: Path) -> "subprocess.CompletedProcess[str]":
    clean = {
        k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COVERAGE", "COV_"))
    }
    return subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=clean | {"COLUMNS": "200"},
    )


def built(source: Path, folder: Path) -> Path:
    """Build a wheel into ``folder``, with the setuptools that is here."""
    command = ["-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source]
    completed = run(sys.executable, *command, cwd=folder)
    assert completed.returncode == 0, completed.stderr
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(binaries: Path, *packages: str | Path, cwd: Path) -> None:
    """Install into another environment with the pip of this one: to give it its own takes 5 s."""
    pip = [sys.executable, "-m", "pip", "--python", binaries / "python"]
    words = ["install", "--quiet", "--no-compile", "--no-warn-conflicts"]
    completed = run(*pip, *words, "-c", ROOT / "constraints.txt", *packages, cwd=cwd)
    assert completed.returncode == 0, completed.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Path:
    """The bin folder of an environment that has the wheel and what it asks for, no extras."""
    folder = tmp_path_factory.mktemp("fresh")
    process = run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    assert process.returncode == 0, process.stderr
    binaries = folder / "venv" / "bin"
    install(binaries, wheel, cwd=folder)
    return binaries


def test_the_wheel_holds_every_room_and_its_data(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for part in (
        "gsgen/__init__.py",
        "gsgen/contract/py.typed",
        "gsgen/contract/schemas/gaussian-generator-1.0.schema.json",
        "gsgen/contract/targets_data/webgpu.json",
        "gsgen/conformance/fixtures/__init__.py",
        "gsgen/sdk/py.typed",
        "gsgen/sdk/templates/plugin/pyproject.toml.in",
        "gsgen/formats/py.typed",
        "gsgen/runtime/py.typed",
        "gsgen/reference_plugins/py.typed",
        "pytest_gsgen.py",
    ):
        assert part in names
    assert not [
        name for name in names if name.startswith(("contract/", "sdk/", "tests/", "tools/"))
    ]


def test_each_module_of_the_wheel_is_reached(wheel: Path) -> None:
    """A module that only tests or builds import belongs to `tests` or `tools`.

    Another module, an entry point or the documentation names it.
    """
    with zipfile.ZipFile(wheel) as archive:
        texts = {
            name: archive.read(name).decode("utf-8")
            for name in archive.namelist()
            if name.endswith((".py", "entry_points.txt"))
        }
    documentation = "".join(path.read_text("utf-8") for path in ROOT.glob("docs/**/*.md"))
    reached_modules = set(_DOTTED.findall(documentation))
    for name, text in texts.items():
        reached_modules |= set(_DOTTED.findall(text)) - {name.removesuffix(".py").replace("/", ".")}
        for room, single, several in _IMPORT_PATTERN.findall(text):
            reached_modules |= {f"{room}.{stem}" for stem in re.findall(r"\w+", single or several)}
    names = {name.removesuffix(".py").replace("/", ".") for name in texts if name.endswith(".py")}
    names = {name for name in names if not name.endswith(("__init__", "__main__", "pytest_gsgen"))}
    tables = ("gsgen.contract.reporters.", "gsgen.cli.commands.")  # imported by names in tables
    by_name = {name for name in names if name.startswith(tables)}
    assert sorted(names - reached_modules - by_name) == []


def test_without_extras_models_are_validated(fresh: Path, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--python", fresh / "python"]
    listed = run(*pip, "list", "--format", "json", cwd=tmp_path).stdout
    installed = {entry["name"].lower() for entry in json.loads(listed)}
    assert "gsgen" in installed
    assert not installed & {"torch", "wgpu", "onnxscript", "onnx-ir", "onnx_ir", "scipy"}
    good = find("drift").write(tmp_path)
    completed = run(fresh / "gsgen", "validate", good, cwd=tmp_path)
    assert completed.returncode == 0, completed.stderr
    assert "conforms" in completed.stdout
    broken = find("opacity_is_logits").write(tmp_path)
    completed = run(fresh / "gsgen", "validate", broken, cwd=tmp_path)
    assert completed.returncode == 1
    assert "GV003 error" in completed.stdout


def test_the_container_s_stages_build_the_wheel_and_run_it(
    wheel: Path, fresh: Path, tmp_path: Path
) -> None:
    """By hand: the files that the recipe copies build the same wheel, and its entry point runs."""
    first, last = (ROOT / "Containerfile").read_text("utf-8").split("\nFROM ")[1:]
    source = tmp_path / "source"
    source.mkdir()
    for line in re.findall(r"^COPY (.+)$", first, re.MULTILINE):
        *names, target = line.split()
        for name in names:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, source / target)
            else:
                shutil.copy(ROOT / name, source / target)
    (build,) = re.findall(r"^RUN pip (wheel .+) --wheel-dir /wheels \.$", first, re.MULTILINE)
    pip = [sys.executable, "-m", "pip", *build.split(), "--quiet", "--no-build-isolation"]
    completed = run(*pip, "--wheel-dir", tmp_path / "wheels", source, cwd=source)
    assert completed.returncode == 0, completed.stderr
    (copy,) = (tmp_path / "wheels").glob("gsgen-*.whl")
    contents = [
        {entry.filename: entry.CRC for entry in zipfile.ZipFile(path).infolist()}
        for path in (copy, wheel)
    ]
    assert contents[0] == contents[1]
    words = [
        json.loads(re.findall(rf"^{name} (.+)$", last, re.MULTILINE)[0])
        for name in ("ENTRYPOINT", "CMD")
    ]
    ran = run(fresh / words[0][0], *words[0][1:], *words[1], cwd=tmp_path)
    assert ran.returncode == 0
    assert "validate" in ran.stdout


def test_the_environment_is_small(fresh: Path) -> None:
    """As `scripts/release.py wheel` measures it, with pip and without compiled files.

    The environment has no pip of its own: the one of the tests is counted.
    """
    files = [path for path in fresh.parent.rglob("*") if not path.is_symlink()]
    pip = distribution("pip").files or ()
    assert pip
    files += [Path(str(path.locate())) for path in pip if path.suffix != ".pyc"]
    assert sum(path.stat().st_size for path in files) <= 250 * 2**20


def test_a_consumer_s_types_are_checked(fresh: Path, tmp_path: Path) -> None:
    """Each package has a py.typed, or mypy would take every name for Any."""
    shutil.copytree(Path(__file__).parent / "consumer", tmp_path / "consumer")
    mypy = [sys.executable, "-m", "mypy", "--strict", "--python-executable", fresh / "python"]
    right = run(*mypy, "consumer/consumer.py", *_programs(tmp_path), cwd=tmp_path)
    assert right.returncode == 0, right.stdout
    wrong = run(*mypy, "consumer/wrong.py", cwd=tmp_path)
    assert wrong.returncode == 1, wrong.stdout
    assert "[arg-type]" in wrong.stdout
    assert "[attr-defined]" in wrong.stdout


def _programs(folder: Path) -> list[Path]:
    """Write the Python programs of the guide into a folder, and return their paths."""
    programs = [block for block in blocks(PROGRAMS) if block.mark.endswith(".py")]
    assert len(programs) == 8
    for block in programs:
        assert len(block.text.strip().splitlines()) <= 8
        (folder / block.mark).write_text(block.text, "utf-8")
    return [folder / block.mark for block in programs]


def test_pyright_agrees(fresh: Path, tmp_path: Path) -> None:
    pyright = package("pyright-1.1.414", needs_node=True) / "index.js"
    files = [Path(__file__).parent / "consumer" / name for name in ("consumer.py", "wrong.py")]
    command = ["node", pyright, "--outputjson", "--pythonpath", fresh / "python"]
    report = json.loads(run(*command, *files, *_programs(tmp_path), cwd=fresh).stdout)
    errors = [(Path(entry["file"]).name, entry["rule"]) for entry in report["generalDiagnostics"]]
    assert sorted(errors) == [
        ("wrong.py", "reportArgumentType"),
        ("wrong.py", "reportAttributeAccessIssue"),
    ]


def test_packed_rows_export_without_torch(fresh: Path, tmp_path: Path) -> None:
    script = (
        "import numpy as np; r = np.zeros((5, 10), 'f4'); r[:, 3] = 0.5; "
        "r[:, [4, 7, 9]] = 0.01; np.savez('rows.npz', gaussians=r, appearance=np.zeros((5, 48), 'f4'))"
    )
    assert run(fresh / "python", "-c", script, cwd=tmp_path).returncode == 0
    completed = run(fresh / "gsgen", "export", "static", "rows.npz", "-o", "m.onnx", cwd=tmp_path)
    assert completed.returncode == 0, completed.stderr
    assert "conforms" in completed.stdout


def test_a_missing_extra_is_named_with_the_line_that_installs_it(
    fresh: Path, tmp_path: Path
) -> None:
    script = "import numpy as np; np.savez('c.npz', points=np.eye(3), colors=np.ones((3, 3)))"
    assert run(fresh / "python", "-c", script, cwd=tmp_path).returncode == 0
    completed = run(fresh / "gsgen", "export", "static", "c.npz", "-o", "m.onnx", cwd=tmp_path)
    assert completed.returncode == 2
    assert "pip install 'gsgen[sdk]'" in completed.stderr
    assert "Traceback" not in completed.stderr


def test_doctor_says_what_is_missing(fresh: Path, tmp_path: Path) -> None:
    completed = run(fresh / "gsgen", "doctor", cwd=tmp_path)
    assert completed.returncode == 0, completed.stdout
    assert "missing torch" in " ".join(completed.stdout.split())
    assert "hint: pip install 'gsgen[sdk]'" in completed.stdout
    assert "hint: pip install 'gsgen[runtime]'" in completed.stdout


@pytest.fixture(scope="module")
def acme(fresh: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Acme]:
    """Runs a command where a third party's package is installed, with what its tests need."""
    folder = tmp_path_factory.mktemp("acme")
    package = built(shutil.copytree(ACME, folder / "package"), tmp_path_factory.mktemp("acme"))
    install(fresh, f"{package}[test]", cwd=folder)
    here = tmp_path_factory.mktemp("studio")
    shutil.copy(ACME / "check_acme.py", here)
    yield lambda name, *words: run(fresh / name, *words, cwd=here)
    pip = [sys.executable, "-m", "pip", "--python", fresh / "python"]
    run(*pip, "uninstall", "-y", "-q", "acme-gsgen", cwd=folder)


def test_a_third_party_brings_a_command(acme: Acme) -> None:
    """A command whose extra is absent is listed with what installs it."""
    assert acme("gsgen", "hello").stdout == "hello from acme\n"
    assert "pip install 'acme-gsgen[extra]'" in acme("gsgen", "--help").stdout
    heavy = acme("gsgen", "heavy", "--any", "thing")
    assert heavy.returncode == 2
    assert "needs no-such-distribution" in heavy.stderr


def test_a_third_party_brings_a_generator_a_target_and_a_rule(acme: Acme) -> None:
    result = acme("gsgen", "export", "row", "-o", "short.onnx")
    assert result.stdout == "short.onnx: 3 in a row\n", result.stderr
    assert acme("gsgen", "export", "row", "-o", "long.onnx", "--count", "5").returncode == 0
    validated = acme("gsgen", "validate", "short.onnx", "long.onnx", "--target", "acme", "-q")
    assert validated.returncode == 1
    assert "long.onnx: invalid" in validated.stdout
    assert "short.onnx: conforms" in validated.stdout
    tested = acme("gsgen", "conformance", "short.onnx", "long.onnx", "--target", "acme")
    assert tested.returncode == 1
    short_output, _, long = tested.stdout.partition("long.onnx")
    assert "acme/AC001" not in short_output
    assert "acme/AC001" in long


def test_a_third_party_s_tests_run_by_pytest_alone(acme: Acme) -> None:
    """Nothing is configured: the installed plugin gives rules, options and the class.

    A warning that pytest could not rewrite a module fails the run.
    """
    quiet_options = ("-q", "-rA", "-p", "no:cacheprovider")
    strict_options = ("-W", "error::pytest.PytestAssertRewriteWarning")
    own = acme("pytest", "check_acme.py", *strict_options, *quiet_options)
    assert own.returncode == 0, own.stdout + own.stderr
    assert "PASSED check_acme.py::TestRow::test_basic[acme/AC001-small-enough]" in own.stdout
    (known,) = [line for line in own.stdout.splitlines() if line.startswith("XFAIL")]
    assert "test_acme_rule_reports_long_rows[long-basic-acme/AC001-small-enough]" in known
    assert "acme/AC001 (Acme draws three.)" in known
    assert "PASSED check_acme.py::test_the_rule_s_example_breaks_it_and_no_other" in own.stdout
    assert "FAILED" not in own.stdout
    model = acme("pytest", "--gsgen", "long.onnx", "--gsgen-target", "acme", *quiet_options)
    assert model.returncode == 1
    (failed,) = [line for line in model.stdout.splitlines() if line.startswith("FAILED")]
    assert "acme/AC001" in failed
    assert "PASSED long.onnx::basic::GV003-opacity-range" in model.stdout

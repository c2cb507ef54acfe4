"""The wheel, installed where nothing else is: a validator without torch and without wgpu."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from support.commands import ROOT


def run(*command: str | Path, cwd: Path) -> "subprocess.CompletedProcess[str]":
    clean = {
        k: v
        for k, v in os.environ.items()
        if not k.startswith(("PYTHON", "COVERAGE", "COV_"))
    }
    return subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=clean | {"COLUMNS": "200"},
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        folder,
        ROOT,
    ]
    done = run(*command, cwd=folder)
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Path:
    """The bin folder of an environment that has the wheel and what it asks for, no extras."""
    folder = tmp_path_factory.mktemp("fresh")
    made = run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    assert made.returncode == 0, made.stderr
    binaries = folder / "venv" / "bin"
    pip = [
        binaries / "python",
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-compile",
        "-c",
        ROOT / "constraints.txt",
    ]
    done = run(*pip, wheel, cwd=folder)
    assert done.returncode == 0, done.stderr
    return binaries


def test_the_wheel_holds_every_room_and_its_data(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for part in (
        "gsgen/contract/py.typed",
        "gsgen/contract/schemas/gaussian-generator-1.0.schema.json",
        "gsgen/contract/targets_data/webgpu.json",
        "gsgen/conformance/fixtures/__init__.py",
        "gsgen/sdk/py.typed",
        "gsgen/formats/py.typed",
        "gsgen/runtime/py.typed",
        "gsgen/reference_plugins/py.typed",
    ):
        assert part in names
    assert "gsgen/__init__.py" not in names  # it would hide the other portions
    assert not [name for name in names if name.startswith(("contract/", "sdk/", "tests/"))]


def test_without_extras_models_are_validated(fresh: Path, tmp_path: Path) -> None:
    listed = run(
        fresh / "python", "-m", "pip", "list", "--format", "json", cwd=tmp_path
    ).stdout
    installed = {entry["name"].lower() for entry in json.loads(listed)}
    assert "gsgen" in installed
    assert not installed & {"torch", "wgpu", "onnxscript", "onnx-ir", "onnx_ir", "scipy"}
    good = find("drift").write(tmp_path)
    ran = run(fresh / "gsgen", "validate", good, cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "conforms" in ran.stdout
    broken = find("opacity_is_logits").write(tmp_path)
    ran = run(fresh / "gsgen", "validate", broken, cwd=tmp_path)
    assert ran.returncode == 1
    assert "GV003 error" in ran.stdout


def test_packed_rows_export_without_torch(fresh: Path, tmp_path: Path) -> None:
    script = (
        "import numpy as np; r = np.zeros((5, 10), 'f4'); r[:, 3] = 0.5; "
        "r[:, [4, 7, 9]] = 0.01; np.savez('rows.npz', gaussians=r, appearance=np.zeros((5, 48), 'f4'))"
    )
    assert run(fresh / "python", "-c", script, cwd=tmp_path).returncode == 0
    ran = run(fresh / "gsgen", "export", "static", "rows.npz", "-o", "m.onnx", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert "conforms" in ran.stdout


def test_a_missing_extra_is_named_with_the_line_that_installs_it(
    fresh: Path, tmp_path: Path
) -> None:
    script = (
        "import numpy as np; np.savez('c.npz', points=np.eye(3), colors=np.ones((3, 3)))"
    )
    assert run(fresh / "python", "-c", script, cwd=tmp_path).returncode == 0
    ran = run(fresh / "gsgen", "export", "static", "c.npz", "-o", "m.onnx", cwd=tmp_path)
    assert ran.returncode == 2
    assert "pip install 'gsgen[sdk]'" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_doctor_says_what_is_missing(fresh: Path, tmp_path: Path) -> None:
    ran = run(fresh / "gsgen", "doctor", cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout
    assert "missing torch" in " ".join(ran.stdout.split())
    assert "mend: pip install 'gsgen[sdk]'" in ran.stdout
    assert "mend: pip install 'gsgen[runtime]'" in ran.stdout


def test_a_third_party_brings_a_command_a_rule_and_a_target(
    fresh: Path, tmp_path: Path
) -> None:
    """Entry points are found; a command whose extra is absent is listed with what installs it."""
    package = tmp_path / "acme_gsgen"
    package.mkdir()
    (package / "acme.py").write_text(ACME)
    (package / "pyproject.toml").write_text(ACME_PROJECT)
    pip = [fresh / "python", "-m", "pip", "install", "--quiet", "--no-compile", "--no-deps"]
    done = run(*pip, "-c", ROOT / "constraints.txt", package, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    try:
        model = find("drift").write(tmp_path)
        ran = run(fresh / "gsgen", "validate", model, "--target", "acme", cwd=tmp_path)
        assert ran.returncode == 1
        assert "acme/AC001 error small-enough" in ran.stdout
        hello = run(fresh / "gsgen", "hello", cwd=tmp_path)
        assert hello.stdout == "hello from acme\n"
        listed = run(fresh / "gsgen", "--help", cwd=tmp_path).stdout
        assert "pip install 'acme-gsgen[extra]'" in listed
        heavy = run(fresh / "gsgen", "heavy", "--any", "thing", cwd=tmp_path)
        assert heavy.returncode == 2
        assert "needs no-such-distribution" in heavy.stderr
    finally:
        run(
            fresh / "python",
            "-m",
            "pip",
            "uninstall",
            "-y",
            "-q",
            "acme-gsgen",
            cwd=tmp_path,
        )


ACME_PROJECT = """
[project]
name = "acme-gsgen"
version = "1"
[project.optional-dependencies]
extra = ["no-such-distribution"]
[project.entry-points."gsgen.rules"]
acme = "acme"
[project.entry-points."gsgen.targets"]
acme = "acme:target"
[project.entry-points."gsgen.commands"]
hello = "acme:hello"
heavy = "acme:hello [extra]"
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"
[tool.setuptools]
py-modules = ["acme"]
"""

ACME = '''
import typer
from dataclasses import replace
from gsgen.contract.finding import Breach, Severity
from gsgen.contract.rule import rule
from gsgen.contract.targets import load_target


def hello() -> None:
    """Say hello."""
    typer.echo("hello from acme")


def target():
    return replace(load_target("core"), name="acme", version="2", limits={"acme_rows": 3})


@rule("acme/AC001", "small-enough", Severity.ERROR, over="model", fixture="", limit="acme_rows")
def small_enough(subject):
    """A model has at most three rows.

    Why:
        Acme's viewer draws three.

    Mend:
        Prune.
    """
    gaussians = subject.declared_gaussians
    if gaussians and gaussians.capacity > subject.target.limits["acme_rows"]:
        yield Breach.at("capacity", str(gaussians.capacity), "3 at most")
'''

"""The plugin in runs that have nothing to do with it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from conformance.pytest_runs import run_pytest

HEAVY_MODULES = {"numpy", "onnx", "onnxruntime", "jsonschema", "typer", "torch", "jaxtyping"}


def test_a_run_without_models_imports_nothing_heavy(folder: Path) -> None:
    (folder / "test_mine.py").write_text("def test_mine():\n    pass\n")
    script = (
        "import json, pytest, sys; code = pytest.main(['-q', '-p', 'gsgen.conformance.pytest.plugin']); "
        "json.dump(list(sys.modules), open('modules.json', 'w')); sys.exit(code)"
    )
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST", "COV"))}
    clean |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    completed = subprocess.run([sys.executable, "-c", script], cwd=folder, env=clean)
    assert completed.returncode == 0
    names = set(json.loads((folder / "modules.json").read_text()))
    assert "gsgen.conformance.pytest.plugin" in names  # the measure works
    assert {name.partition(".")[0] for name in names} & HEAVY_MODULES == set()
    assert {name for name in names if name.startswith("gsgen.")} == {
        *("gsgen.conformance", "gsgen.conformance.pytest", "gsgen.conformance.pytest.plugin")
    }


def test_pytest_finds_the_plugin_and_its_options_clash_with_none() -> None:
    """In this environment, with every plugin that is installed here."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    command = [sys.executable, "-m", "pytest", "--help"]
    completed = subprocess.run(
        command, capture_output=True, text=True, env=clean | {"COLUMNS": "200"}
    )
    assert completed.returncode == 0, completed.stderr
    text = completed.stdout.partition("conformance of Gaussian Generators:")[2]
    section = text.partition("\n\n")[0]
    options = {word for word in section.split() if word.startswith("--")}
    assert {option.partition("=")[0] for option in options} >= {
        *("--gsgen", "--gsgen-target", "--gsgen-level", "--gsgen-suite"),
        *("--gsgen-xfails", "--gsgen-fail-on", "--gsgen-dump", "--gsgen-config"),
    }
    assert all(option.startswith("--gsgen") for option in options)


def test_public_names_are_those_that_authors_use() -> None:
    import gsgen.conformance as conformance

    for name in conformance.__all__:
        assert getattr(conformance, name).__name__ == name
    with pytest.raises(AttributeError):
        _ = conformance.nothing


def test_the_marker_is_known_to_strict_runs(folder: Path) -> None:
    completed = run_pytest(folder, "--markers")
    assert "gsgen_rules(request)" in completed.out

"""Text is read and written as UTF-8, whatever the system's locale: each call names an encoding."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.commands import ROOT

FOLDERS = ("contract", "sdk", "runtime", "reference_plugins", "scripts", "docs/examples")
FILES = sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
# Positions of the argument `encoding`, counted from 0.
POSITIONS = {"read_text": 0, "write_text": 1}


def violations(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = name or (node.func.id if isinstance(node.func, ast.Name) else "")
            if _reads_or_writes_text(node, name) and not _has_encoding(node, name):
                yield f"line {node.lineno}: {ast.unparse(node)[:80]}"


def _has_encoding(node: ast.Call, name: str) -> bool:
    has_position = name in POSITIONS and len(node.args) > POSITIONS[name]
    return has_position or any(word.arg in ("encoding", None) for word in node.keywords)


def _reads_or_writes_text(node: ast.Call, name: str) -> bool:
    keywords = {word.arg: word.value for word in node.keywords}
    if name in ("run", "Popen", "check_output", "check_call"):
        return any(word in keywords for word in ("text", "universal_newlines"))
    if name in POSITIONS:
        # `write_text` of gsgen.cli.output is a function that writes UTF-8.
        return isinstance(node.func, ast.Attribute)
    if name in ("NamedTemporaryFile", "TemporaryFile", "fdopen", "open"):
        mode = keywords.get("mode") or next((a for a in node.args if _is_mode(a)), None)
        if mode is None:
            return name == "open" and isinstance(node.func, ast.Name)
        return isinstance(mode, ast.Constant) and "b" not in str(mode.value)
    return False


def _is_mode(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and str(node.value) in {
        f"{kind}{suffix}" for kind in "rwax" for suffix in ("", "b", "+", "b+", "+b")
    }


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_text_file_has_an_encoding(folder: str) -> None:
    files = [file for file in FILES if file.is_relative_to(ROOT / folder)]
    assert files
    missing = {
        file.relative_to(ROOT).as_posix(): lines
        for file in files
        if (lines := list(violations(ast.parse(file.read_text("utf-8")))))
    }
    assert not missing


@pytest.mark.parametrize(
    "code",
    [
        "open(path)",
        "open(path, 'w')",
        "path.open('a')",
        "path.read_text()",
        "path.read_text(errors='replace')",
        "path.write_text(text)",
        "subprocess.run(command, text=True)",
        "os.fdopen(handle, 'w')",
    ],
)
def test_a_call_without_encoding_is_reported(code: str) -> None:
    assert list(violations(ast.parse(code)))


@pytest.mark.parametrize(
    "code",
    [
        "open(path, 'rb')",
        "path.open('w', encoding='utf-8')",
        "path.read_text('utf-8')",
        "path.write_text(text, 'utf-8')",
        "subprocess.run(command)",
        "Image.open(path)",
        "open_model(path)",
    ],
)
def test_calls_with_encoding_or_binary_mode_pass(code: str) -> None:
    assert not list(violations(ast.parse(code)))


def test_the_folders_hold_the_packages() -> None:
    assert Path(ROOT / "reference_plugins/gsgen/cli/app.py") in FILES

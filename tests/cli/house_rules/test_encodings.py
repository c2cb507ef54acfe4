"""Every command prints into every encoding, into files, pipes and terminals, and never crashes."""

import codecs
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main
from typer.core import TyperGroup

from gsgen.cli.command_group import build
from gsgen.cli.text_streams import accept_any_text, transliterate
from gsgen.conformance.fixtures import find
from support.commands import ROOT

# Names of files that no 8-bit encoding has whole.
MODEL, BROKEN, CLOUD, ABSENT = "gut→é.onnx", "schlecht≤日.onnx", "wolke−σ.npz", "fehlt→日🌐.onnx"

# A command line for each command; `{}` is a folder that no other run writes into.
CALLS = [
    ["validate", MODEL, BROKEN, "--level", "values"],
    ["inspect", MODEL],
    ["inspect", MODEL, "--json"],
    ["viewer-kit", "check", "{}/kit→", "{}"],
    ["viewer-kit", "write", MODEL],
    ["explain", "GV003", "GG003", "GV009", "GG020", "GG021", "GT001"],
    ["rules"],
    ["rules", "--json"],
    ["new", "my-method", "--into", "{}/neu→"],
    ["plugins"],
    ["plugins", "--json"],
    ["rewrite", "--list"],
    ["convert", CLOUD, "{}/wolke→.ply"],
    ["tiles", "build", CLOUD, "-o", "{}/kacheln→", "--engine", "serial"],
    ["tiles", "info", "{}/kacheln→"],
    ["tiles", "pack", "{}/kacheln→", "-o", "{}/kacheln→.3tz"],
    ["tiles", "serve", ABSENT],
    ["tiles", "simulate", "{}/kacheln→", "--path", ABSENT, "--network", ABSENT],
]
# These run models or draw, for a second or two each: they are not repeated in every run.
SLOW_CALLS = [
    ["validate", BROKEN, "--level", "values", "--json"],
    ["validate", BROKEN, "--level", "values", "--format", "markdown"],
    ["validate", BROKEN, "--level", "values", "--format", "github"],
    ["validate", BROKEN, "--level", "values", "--format", "sarif"],
    ["validate", BROKEN, "--level", "values", "--format", "junit"],
    ["conformance", BROKEN, "--level", "values"],
    ["repro", BROKEN, "--rule", "GV003"],
    ["vectors", MODEL, "--into", "{}/vektoren→"],
    ["export", "static", CLOUD, "-o", "{}/aus→.onnx", "--level", "static"],
    ["diff", MODEL, BROKEN],
    ["fix", BROKEN, "--dry-run"],
    ["rewrite", BROKEN, "--dry-run"],
    ["float16", MODEL, "--dry-run", "--budget", "4"],
    ["bench", MODEL, "--provider", "cpu", "--frames", "2"],
    ["doctor"],
    ["render", CLOUD, "--width", "32", "--height", "24", "-o", "{}/bild→.png"],
    ["bake", MODEL, "-o", "{}/gebacken→.ply"],
    ["card", MODEL, "-o", "{}/karte→"],
    ["samples", "{}/beispiele→"],
    ["bench-render", CLOUD, "--width", "32", "--height", "24", "--frames", "2"],
    ["references", MODEL, "--width", "16", "--count", "1", "-o", "{}/kopie→.onnx"],
    ["tiles", "score", "{}/kacheln→", CLOUD, "--width", "32", "--height", "32"],
]
WRITES_ANY_FOLDER = (["viewer-kit", "write"], ["samples"])  # an unknown name is no mistake
WINDOW = "view"  # opens a window: only its help and its errors are printed here

NARROW, WIDE = {"COLUMNS": "40"}, {"COLUMNS": "200"}
C_LOCALE = {"PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}
RUNS = {
    "utf-8, pipe": ("utf-8", "pipe", WIDE),
    "utf-8, file": ("utf-8", "file", NARROW | {"NO_COLOR": "1"}),
    "cp1252, pipe": ("cp1252", "pipe", WIDE | {"NO_COLOR": "1"}),
    "cp1252, file": ("cp1252", "file", NARROW | {"FORCE_COLOR": "1"}),
    "ascii, pipe": ("ascii", "pipe", NARROW | {"FORCE_COLOR": "1"}),
    "ascii, file": ("ascii", "file", WIDE),
    "C locale, pipe": ("ascii", "pipe", WIDE | C_LOCALE),
    "cp1252, terminal": ("cp1252", "terminal", NARROW),
    "ascii, terminal": ("ascii", "terminal", WIDE | C_LOCALE),
}
FULL_CHARSETS = ("utf-8, pipe", "cp1252, pipe", "ascii, file")


def command_paths() -> Iterator[list[str]]:
    """Yield the words of every command and every group, from the program's own table."""
    yield []
    loaded = typer.main.get_command(build())
    assert isinstance(loaded, TyperGroup)
    context = typer.Context(loaded)
    for name in loaded.list_commands(context):
        command = loaded.get_command(context, name)
        yield [name]
        if isinstance(command, TyperGroup):
            subcontext = typer.Context(command)
            yield from ([name, word] for word in command.list_commands(subcontext))


def every_call(slow: bool) -> list[list[str]]:
    paths = list(command_paths())
    helps = [[*path, "--help"] for path in paths]
    wrong = [[*path, ABSENT] for path in paths if path not in WRITES_ANY_FOLDER]
    wrong += [[*path, "--opt→ion"] for path in paths]
    return [*helps, *wrong, *CALLS, *(SLOW_CALLS if slow else ())]


def test_every_command_has_a_call() -> None:
    called = {tuple(call[:2]) for call in CALLS + SLOW_CALLS} | {
        (call[0],) for call in CALLS + SLOW_CALLS
    }
    groups = {path[0] for path in command_paths() if len(path) == 2} - {"export"}
    leaves = [path for path in command_paths() if (path and path[0] not in groups) or path[1:]]
    missing = [path for path in leaves if path[0] != "export" and tuple(path) not in called]
    assert missing == [[WINDOW]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drucken")
    for fixture, name in (("still_rgb", MODEL), ("opacity_is_logits", BROKEN)):
        find(fixture).write(folder).rename(folder / name)
    rng = np.random.default_rng(0)
    rows = np.zeros((60, 10), np.float32)
    rows[:, :3] = rng.normal(size=(60, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    color = np.full((60, 3), 0.5, np.float32)
    np.savez(folder / CLOUD, gaussians=rows, appearance=color)
    return folder


_MODULE = "cli.house_rules.printed_commands"


def printed(
    folder: Path, calls: list[list[str]], encoding: str, sink: str, surroundings: dict[str, str]
) -> list[tuple[int, str]]:
    """Run command lines, and return the exit code and the decoded output of each."""
    own = folder / f"{encoding}-{sink}-{len(surroundings)}"
    own.mkdir()
    lines = [[word.replace("{}", own.name) for word in call] for call in calls]
    (own / "calls.json").write_text(json.dumps(lines), "utf-8")
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "GITHUB_ACTIONS", "PYTHONIOENCODING")
        and not name.startswith("LC_")
    } | {"PYTHONPATH": str(ROOT / "tests"), "TERM": "xterm-256color"}
    if "LC_ALL" not in surroundings:
        environment["PYTHONIOENCODING"] = encoding
    command = [sys.executable, "-m", _MODULE, str(own / "calls.json")]
    raw = collect(command, folder, environment | surroundings, sink, own / "printed")
    *records, remaining = raw.decode(encoding, "strict").split("\x1f")
    assert not remaining.strip(), remaining
    outputs = [record.rpartition("\x1e") for record in records]
    assert len(outputs) == len(calls)
    return [(int(code), text) for text, _, code in outputs]


def collect(
    command: list[str], folder: Path, environment: dict[str, str], sink: str, target: Path
) -> bytes:
    options: dict[str, Any] = {
        "cwd": folder,
        "env": environment,
        "stdin": subprocess.DEVNULL,
        "stderr": subprocess.STDOUT,
    }
    if sink == "pipe":
        return subprocess.run(command, **options, stdout=subprocess.PIPE, timeout=240).stdout
    if sink == "file":
        with target.open("wb") as file:
            subprocess.run(command, **options, stdout=file, timeout=240, check=True)
        return target.read_bytes()
    pty = pytest.importorskip("pty")  # Windows has none
    own_end, child_end = pty.openpty()
    process = subprocess.Popen(command, **options, stdout=child_end)
    os.close(child_end)
    chunks = []
    while True:
        try:
            chunk = os.read(own_end, 1 << 16)
        except OSError:  # the other end was closed
            break
        if not chunk:
            break
        chunks.append(chunk)
    os.close(own_end)
    assert process.wait(60) == 0
    return b"".join(chunks)


@pytest.fixture(scope="module")
def expected(folder: Path) -> list[tuple[int, str]]:
    encoding, sink, surroundings = RUNS["utf-8, pipe"]
    return printed(folder, every_call(slow=True), encoding, sink, surroundings)


@pytest.mark.slow
def test_no_command_crashes_where_everything_can_be_printed(
    expected: list[tuple[int, str]],
) -> None:
    for call, (code, text) in zip(every_call(slow=True), expected, strict=True):
        assert code in (0, 1, 2, 4), (call, code, text)
        assert "Traceback" not in text, (call, text)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in RUNS if name != "utf-8, pipe"])
def test_every_command_prints_in_each_encoding(
    name: str, folder: Path, expected: list[tuple[int, str]]
) -> None:
    encoding, sink, surroundings = RUNS[name]
    calls = every_call(slow=name in FULL_CHARSETS)
    outputs = printed(folder, calls, encoding, sink, surroundings)
    for call, (code, text), (expected_code, expected_text) in zip(
        calls, outputs, expected, strict=False
    ):
        assert (call, code) == (call, expected_code), text
        assert "Traceback" not in text, (call, text)
        assert "UnicodeEncodeError" not in text, (call, text)
        assert bool(text.strip()) == bool(expected_text.strip()), call
        if call in (["rules"], ["explain", "GV003"]):
            lines = text.replace("\r\n", "\n")
            assert lines == as_encoded(expected_text, encoding)
        if call in (["rules", "--json"], ["plugins", "--json"]):
            assert json.loads(text) == json.loads(expected_text)


def as_encoded(text: str, encoding: str) -> str:
    codecs.register_error("test-transliterate", transliterate)
    return text.encode(encoding, "test-transliterate").decode(encoding)


@pytest.mark.parametrize(
    ("text", "ascii_text"),
    [
        ("a → b ≤ c − d", "a -> b <= c - d"),
        ("Σᵢ αᵢ xᵀ · 10⁻³ ½ σ²", "Sigma_i alpha_i x^T * 10^-^3 1/2 sigma^2"),
        ("日 🌐 \udcff", "\\u65e5 \\ud83c\\udf10 \\udcff"),
    ],
)
def test_characters_that_are_missing_are_transliterated(text: str, ascii_text: str) -> None:
    assert as_encoded(text, "ascii") == ascii_text


def test_json_keeps_its_meaning() -> None:
    document = {"path": "日→🌐é", "text": "σ ≤ 1"}
    text = json.dumps(document, ensure_ascii=False) + "\n"
    assert json.loads(as_encoded(text, "ascii")) == document
    assert json.loads(as_encoded(text, "cp1252")) == document


def test_bytes_that_cannot_be_decoded_are_still_errors() -> None:
    codecs.register_error("test-transliterate", transliterate)
    with pytest.raises(UnicodeDecodeError):
        b"\xff".decode("ascii", "test-transliterate")


def test_a_process_without_stdout_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    accept_any_text()
    assert sys.stdout is None

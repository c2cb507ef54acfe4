"""Commands work in poor surroundings, or say in one line what they lack; none prints a traceback."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Final

import pytest

from cli.house_rules.test_plugin_faults import run_with_plugin
from gsgen.conformance.fixtures import find
from gsgen.formats import write_ply
from support.commands import Ran, gsgen_here
from support.models.endless import endless
from support.splat_files import scene
from support.unwritable_runs import can_mount

PROGRAM: Final = f"{sys.executable} -m gsgen.cli"
SMALL: Final = ("--width", "16", "--height", "16")


@pytest.fixture(autouse=True)
def _files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    find("drift").write(tmp_path)
    write_ply(tmp_path / "cloud.ply", scene(20, 0))


def run_in_shell(script: str, **variables: str) -> Ran:
    done = subprocess.run(
        ["sh", "-c", script], capture_output=True, env=os.environ | variables, timeout=100
    )
    texts = [text.decode("utf-8", "replace") for text in (done.stdout, done.stderr)]
    return Ran(done.returncode, *texts)


def require_no_traceback(run: Ran) -> None:
    assert "Traceback" not in run.out + run.err, run
    assert "Exception ignored" not in run.err, run
    assert run.code != 3, run


@pytest.mark.parametrize(
    "words",
    [
        "rules",
        "--help",
        *(
            pytest.param(words, marks=pytest.mark.slow)
            for words in ("rules --json", "render --help", "--version", "inspect drift.onnx")
        ),
    ],
)
@pytest.mark.parametrize(
    ("end", "code"),
    [("| true", 2), (">&-", 2), ("<&-", 0), (">&- 2>&-", 2), ("<&- >&- 2>&-", 2)],
    ids=["pipe without a reader", "no stdout", "no stdin", "no output", "no stream"],
)
def test_closed_stream_is_no_traceback(words: str, end: str, code: int) -> None:
    run = run_in_shell(f"{{ {PROGRAM} {words}; echo $? > code; }} {end}")
    require_no_traceback(run)
    assert int(Path("code").read_text()) == code
    assert len(run.err.splitlines()) == (2 if end == ">&-" else 0), run


def test_file_opened_without_stdout_gets_no_printed_text() -> None:
    run = run_in_shell(f"{PROGRAM} convert cloud.ply copy.ply <&- >&-")
    assert run.code == 2, run
    assert "Standard output is closed" in run.err
    assert Path("copy.ply").read_bytes() == Path("cloud.ply").read_bytes()


@pytest.mark.parametrize(
    "words",
    ["inspect {}/drift.onnx", "convert {}/cloud.ply x.ply", "samples x", "tiles info x", "rules"],
)
def test_deleted_current_folder_is_at_most_one_error(tmp_path: Path, words: str) -> None:
    run = run_in_shell(f"mkdir gone; cd gone; rmdir ../gone; {PROGRAM} {words.format(tmp_path)}")
    require_no_traceback(run)
    assert run.code == (0 if words.startswith(("inspect", "rules")) else 2)
    assert len([line for line in run.err.splitlines() if line.startswith("gsgen: ")]) <= 1


@pytest.mark.parametrize(
    "variables",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"PYTHONIOENCODING": "cp1252"},
        {"PYTHONIOENCODING": "utf-16"},
        {"HOME": "/proc/1/absent", "XDG_CACHE_HOME": "/proc/1/absent"},
        {"HOME": "", "XDG_CACHE_HOME": ""},
    ],
    ids=["C locale", "cp1252", "utf-16", "no home", "empty home"],
)
@pytest.mark.parametrize("words", ["rules", "validate drift.onnx --level static"])
def test_locale_and_home_do_not_matter(variables: dict[str, str], words: str) -> None:
    run = run_in_shell(f"{PROGRAM} {words}", **variables)
    require_no_traceback(run)
    assert run.code == 0, run


@pytest.mark.skipif(not can_mount(), reason="no namespaces to be the first process in")
def test_first_process_of_a_container_ends_at_sigterm(tmp_path: Path) -> None:
    """The system gives the first process no signal that it has no handler for."""
    model = endless(tmp_path, 0.5)
    namespace = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    words = [*namespace, sys.executable, "-m", "gsgen.cli", "validate", str(model)]
    drafts = tmp_path / "drafts"
    drafts.mkdir()
    with subprocess.Popen(words, env=os.environ | {"TMPDIR": str(drafts)}) as running:
        try:
            end = time.monotonic() + 100
            while not list(drafts.glob("gsgen-*/events.jsonl")):
                assert time.monotonic() < end
                time.sleep(0.05)
            children = Path(f"/proc/{running.pid}/task/{running.pid}/children").read_text()
            os.kill(int(children.split()[0]), signal.SIGTERM)
            assert running.wait(100) == 143
        finally:
            running.kill()
    assert not list(drafts.glob("gsgen-*"))


# Command → words in which NAME stands for a file name that is not UTF-8.
NAMES: Final[dict[str, tuple[str, ...]]] = {
    "validate": ("validate", "NAME.onnx", "--level", "static"),
    "validate values": ("validate", "NAME.onnx"),
    "validate output": ("validate", "drift.onnx", "--level", "static", "-o", "NAME.txt"),
    "inspect": ("inspect", "NAME.onnx"),
    "card": ("card", "NAME.onnx"),
    "diff": ("diff", "NAME.onnx", "drift.onnx"),
    "vectors": ("vectors", "NAME.onnx", "--count", "1"),
    "fix": ("fix", "NAME.onnx", "--dry-run"),
    "conformance": ("conformance", "NAME.onnx"),
    "repro": ("repro", "NAME.onnx", "--rule", "GV003"),
    "render a model": ("render", "NAME.onnx", *SMALL, "-o", "x.png"),
    "render splats": ("render", "NAME.ply", *SMALL, "-o", "x.png"),
    "render a mesh": ("render", "NAME.obj", *SMALL, "-o", "x.png"),
    "render output": ("render", "cloud.ply", *SMALL, "-o", "NAME2.png"),
    "render camera": ("render", "cloud.ply", *SMALL, "--camera", "NAME.json", "-o", "x.png"),
    "render log": ("render", "cloud.ply", *SMALL, "--log", "NAME.log", "-o", "x.png"),
    "convert": ("convert", "NAME.ply", "x.spz"),
    "convert output": ("convert", "cloud.ply", "NAME2.sog"),
    "bake": ("bake", "NAME.onnx", "--time", "0", "-o", "NAME2.ply"),
    "export": ("export", "static", "NAME.ply", "--level", "static", "-o", "x.onnx"),
    "export output": ("export", "static", "cloud.ply", "--level", "static", "-o", "NAME2.onnx"),
    "export a page": ("export", "html", "NAME.ply", "-o", "NAME.html"),
    "tiles build": ("tiles", "build", "NAME.ply", "-o", "NAME-tiles"),
    "tiles info": ("tiles", "info", "NAME-absent"),
    "tiles pack": ("tiles", "pack", "NAME-absent", "-o", "NAME.3tz"),
    "samples": ("samples", "NAME-samples"),
    "new": ("new", "NAME"),
    "no such command": ("NAME",),
    "no such file": ("inspect", "NAME-absent.onnx"),
}  # fmt: skip
REFUSED: Final = {
    "fix": 1, "render a mesh": 4, "render camera": 2, "export output": 2, "tiles info": 4,
    "tiles pack": 4, "new": 2, "no such command": 2, "no such file": 4,
}  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_name_that_is_not_utf8_is_taken_or_refused_in_one_line(name: str) -> None:
    bad_name = os.fsdecode(b"m\xff")
    shutil.copy("drift.onnx", f"{bad_name}.onnx")
    shutil.copy("cloud.ply", f"{bad_name}.ply")
    Path(f"{bad_name}.json").write_text("{}")
    Path(f"{bad_name}.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    run = gsgen_here(*(word.replace("NAME", bad_name) for word in NAMES[name]))
    require_no_traceback(run)
    assert run.code == REFUSED.get(name, 0), run


@pytest.mark.parametrize(
    ("group", "words"),
    [("gsgen.commands", ("acme",)), ("gsgen.generators", ("export", "acme", "-o", "x.onnx"))],
)
@pytest.mark.parametrize(
    "code",
    ["", "import sys\nsys.modules[__name__] = 7", "import sys\nsys.modules[__name__] = None",
     "import sys\ndef f(value: object): pass\nsys.modules[__name__] = f",
     "import sys\nsys.modules[__name__] = dict"],
    ids=["module", "number", "None", "function of an unknown type", "class"],
)  # fmt: skip
def test_entry_point_that_is_no_command_is_one_line(
    tmp_path: Path, group: str, words: tuple[str, ...], code: str
) -> None:
    site = tmp_path / "site"
    site.mkdir()
    run = run_with_plugin(tmp_path, site, group, code, *words)
    assert "Traceback" not in run.err, run
    assert "internal error" not in run.err, run
    assert run.code != 0
    assert "acme" in run.err

"""Whatever the names in a file are, no command prints a character that controls a terminal."""

import json
import re
import unicodedata
from pathlib import Path

import onnx
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gsgen.conformance.fixtures import find
from support.commands import Ran, gsgen, gsgen_here

NASTY = "x\x1b[2J\x9b1m\n::error::forged\n\u202eoklahoma\u200b\r##[error]y<script>alert(1)</script>"
FORMATS = ("text", "json", "sarif", "junit", "markdown", "github", "html")
# MODEL and OTHER are files whose names and contents have the text.
COMMANDS: dict[str, tuple[str, ...]] = {
    **{f"validate {f}": ("validate", "MODEL", "--level", "static", "--format", f) for f in FORMATS},
    "validate -v": ("validate", "MODEL", "OTHER", "--level", "static", "-v"),
    "validate -q": ("validate", "MODEL", "--level", "static", "-q"),
    "validate target": ("validate", "MODEL", "--target", "TEXT"),
    "validate missing": ("validate", "TEXT.onnx"),
    "inspect": ("inspect", "MODEL"),
    "inspect --json": ("inspect", "MODEL", "--json"),
    "inspect --emit-manifest": ("inspect", "MODEL", "--emit-manifest"),
    "inspect text": ("inspect", "UNREADABLE"),
    "diff": ("diff", "MODEL", "OTHER"),
    "diff --json": ("diff", "MODEL", "OTHER", "--json"),
    "card": ("card", "MODEL"),
    "conformance": ("conformance", "MODEL", "--level", "static"),
    "conformance --json": ("conformance", "MODEL", "--level", "static", "--json"),
    "explain": ("explain", "TEXT"),
    "rules": ("rules", "TEXT"),
    "plugins": ("plugins", "TEXT"),
    "export": ("export", "TEXT"),
    "export module": ("export", "absent:TEXT", "-o", "x.onnx"),
    "unknown command": ("TEXT",),
    "unknown option": ("inspect", "--TEXT"),
    "tiles info": ("tiles", "info", "TEXT"),
    "convert": ("convert", "UNREADABLE", "TEXT.ply"),
    "render": ("render", "TEXT.ply", "-o", "out.png"),
    "repro": ("repro", "MODEL", "--rule", "GV003"),
    "fix": ("fix", "MODEL", "--dry-run"),
    "float16": ("float16", "MODEL", "--dry-run"),
    "rewrite": ("rewrite", "MODEL", "--dry-run"),
}  # fmt: skip


def write_model(path: Path, text: str, fixture: str) -> Path:
    """Write a model in whose names, manifest and metadata a text stands."""
    written = find(fixture).write(path.parent / "plain")
    model = onnx.load(written)
    model.producer_name = model.domain = model.doc_string = text
    model.graph.name = text
    for node in model.graph.node:
        node.name = f"{text}{node.name}"
    names = {value.name: f"{text}{value.name}" for value in model.graph.input}
    for value in model.graph.input:
        value.name = names[value.name]
    for node in model.graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]
    for entry in model.metadata_props:
        if entry.key.startswith("gaussian") or entry.value.startswith("{"):
            manifest = json.loads(entry.value)
            manifest["name"] = text
            manifest["producer"] = {"tool": text, "source": text, "license": text}
            for declared in manifest.get("inputs", ()):
                declared["name"] = names.get(declared["name"], declared["name"])
            entry.value = json.dumps(manifest)
    path.write_bytes(model.SerializeToString())
    return path


def run_command(name: str, text: str, folder: Path, *, in_process: bool = True) -> Ran:
    file_text = text.replace("/", "_").replace("\0", "").encode("utf-8", "replace").decode()[:60]
    (folder / "plain").mkdir(exist_ok=True)
    files = {
        "MODEL": write_model(folder / f"{file_text}.onnx", text, "opacity_is_logits").name,
        "OTHER": write_model(folder / f"{file_text} other.onnx", f"{text}2", "drift").name,
        "UNREADABLE": f"{file_text}.ply",
    }
    (folder / files["UNREADABLE"]).write_text(f"ply\n{file_text}", "utf-8")
    words = [files.get(word, word).replace("TEXT", file_text) for word in COMMANDS[name]]
    run = gsgen_here if in_process else gsgen
    return run(*words, cwd=folder)


def require_harmless(printed: str, *, is_github: bool = False) -> None:
    hidden = ("Cc", "Cf", "Zl", "Zp", "Cs")
    controls = {c for c in printed if unicodedata.category(c) in hidden} - {"\n", "\t"}
    assert not controls, ascii(printed)
    assert "##[" not in printed
    command = re.compile(r"::(error|warning|notice) file=[^:,\n]*,title=[^:,\n]*::.")
    for line in printed.split("\n"):
        if line.lstrip().startswith("::"):
            assert is_github, line
            assert command.match(line), line


@pytest.mark.parametrize("name", COMMANDS)
def test_printed_text_controls_no_terminal(name: str, tmp_path: Path) -> None:
    completed = run_command(name, NASTY, tmp_path)
    assert completed.out + completed.err
    assert "Traceback" not in completed.err
    require_harmless(completed.out, is_github="github" in name)
    require_harmless(completed.err)
    for line in (completed.out + completed.err).split("\n"):
        assert not line.lstrip().startswith("forged")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(text=st.text(min_size=1, max_size=20))
def test_printed_text_controls_no_terminal_for_any_name(
    name: str, text: str, tmp_path: Path
) -> None:
    text = text.encode("utf-8", "replace").decode()
    completed = run_command(name, text, tmp_path)
    require_harmless(completed.out, is_github="github" in name)
    require_harmless(completed.err)


@pytest.mark.parametrize("stream", ["out", "err"])
def test_a_process_escapes_what_it_prints(stream: str, tmp_path: Path) -> None:
    name = "inspect" if stream == "out" else "validate missing"
    require_harmless(getattr(run_command(name, NASTY, tmp_path, in_process=False), stream))


def test_card_is_one_document_of_yaml_and_adds_no_element(tmp_path: Path) -> None:
    text = 'mit\n---\ntags: [forged]\n<img src=x onerror=alert(1)>\n```bash\nrm -rf /\n"'
    card = run_command("card", text, tmp_path).out
    _, front_matter, body = card.split("---\n", 2)
    document = yaml.safe_load(front_matter)
    assert document["library_name"] == "gsgen"
    assert "forged" not in document["tags"]
    assert "forged" in document["license"]
    outside = re.sub(r"(?ms)^```bash$.*^```$", "", body).replace("\\`", "")
    outside = re.sub(r"(`+)[^\n]*?(?<!`)\1(?!`)", "", outside)
    assert not re.search(r"(?<!\\)<img", outside)
    assert re.findall("(?m)^`{3,}[^`\n]*$", body) == ["```bash", "```"]

"""Ten things that people open first give a result, or one sentence with what to do."""

from pathlib import Path

import pytest

from support.ten_things import COMMANDS, Answer, answer, ten_things

# Thing → a part of the sentence that every command without a result says.
SENTENCES = {
    "Blender transforms": "a file of cameras (transforms.json)",
    "LFS pointer": "a git LFS pointer",
}
# Commands that have a result for every other thing but those below.
RESULTS = {"render": "a.png", "convert": "a.spz", "export static": "a.onnx"}
NO_RESULTS = [("convert", "mesh in a GLB"), ("export static", "mesh in a GLB")]


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_ten_things_have_an_answer(command: str, tmp_path: Path) -> None:
    with ten_things(tmp_path) as things:
        answers = {name: answer(command, thing, tmp_path) for name, thing in things.items()}
    assert {name: entry.fault for name, entry in answers.items() if entry.fault} == {}
    for name, sentence in SENTENCES.items():
        assert sentence in answers[name].errors[0]
    assert answers["broken file"].code != 0
    if command in RESULTS:
        readable = [
            name
            for name in things
            if name not in (*SENTENCES, "broken file") and (command, name) not in NO_RESULTS
        ]
        files = {name: answers[name].files for name in readable}
        assert files == dict.fromkeys(readable, (RESULTS[command],))


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        (Answer(code=0, files=("a.png",), errors=(), out=""), ""),
        (Answer(code=0, files=(), errors=(), out=""), "exit code 0 without a result"),
        (Answer(code=4, files=(), errors=("gsgen: a\n  do this",), out=""), ""),
        (Answer(code=4, files=(), errors=("gsgen: a",), out=""), "does not say what to do"),
        (
            Answer(code=4, files=(), errors=("gsgen: a\n  expected b",), out=""),
            "does not say what to do",
        ),
        (Answer(code=4, files=(), errors=("a\n  b", "c\n  d"), out=""), "2 errors"),
        (Answer(code=3, files=(), errors=("a\n  b",), out=""), "a crash"),
        (Answer(code=2, files=("a",), errors=("a\n  b",), out=""), "an error, and a file"),
    ],
)
def test_a_fault_of_an_answer_is_named(entry: Answer, fault: str) -> None:
    assert fault in entry.fault
    assert bool(entry.fault) == bool(fault)

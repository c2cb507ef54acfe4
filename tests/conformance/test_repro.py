"""`gsgen repro`: one rule again, by one probe where that is enough."""

from pathlib import Path

import numpy as np
import pytest

from conformance.conftest import write
from support.commands import gsgen


def test_a_probe_that_breaks_a_rule_shows_its_rows_and_exits_1(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    dump = folder / "deep" / "out.npz"
    ran = gsgen("repro", model, "--rule", "opacity-range", "--probe", "0", "--dump", dump)
    assert ran.code == 1, ran.err
    assert "GV003 error opacity-range" in ran.out
    assert "rows at probe no inputs:" in ran.out
    assert "5.02" in ran.out
    assert ran.out.index("reproduced: GV003 is broken") > ran.out.index("opacity")
    with np.load(dump) as arrays:
        (packed,) = [arrays[name] for name in arrays if arrays[name].shape[1:] == (10,)]
    assert packed[3, 3] == np.float32(5.02)


def test_without_a_probe_all_are_judged(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    ran = gsgen("repro", model, "--rule", "GV003")
    assert ran.code == 1
    assert "rows at probe no inputs:" in ran.out


def test_a_rule_that_holds_exits_0(folder: Path) -> None:
    (model,) = write(folder, "drift")
    ran = gsgen("repro", model, "--rule", "GV003", "--probe", "time=0.286")
    assert ran.code == 0
    assert ran.out == f"does not reproduce: GV003 holds for {model} at probe time=0.286\n"


@pytest.mark.parametrize(
    ("name", "options", "code", "words"),
    [
        ("drift", ("--rule", "GV999"), 2, "--rule: unknown rule 'GV999'"),
        ("drift", ("--rule", "GV003", "--probe", "time=2"), 2, "unknown probe 'time=2'"),
        ("drift", ("--rule", "GB001", "--probe", "0"), 2, "Leave --probe out."),
        ("drift", ("--rule", "TV101"), 2, "only for target visionary"),
        ("trajectory", ("--rule", "GV003"), 2, "only for kind gaussian-generator"),
        ("view_flattened", ("--rule", "GV003", "--probe", "0"), 2, "GI001 does not hold"),
        ("view_flattened", ("--rule", "GV003"), 2, "GI001 does not hold"),
        ("", ("--rule", "GV003"), 4, "empty"),
    ],
)
def test_what_cannot_be_judged_is_neither_broken_nor_held(
    folder: Path, name: str, options: tuple[str, ...], code: int, words: str
) -> None:
    model = write(folder, name)[0] if name else folder / "empty.onnx"
    model.touch()
    ran = gsgen("repro", model, *options)
    assert ran.code == code, ran.out
    assert words in ran.err
    assert "Traceback" not in ran.err

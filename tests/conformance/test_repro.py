"""`gsgen repro`: one rule again, by one probe where that is enough."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conformance.pytest_runs import write
from gsgen.conformance.reproduction import reproduce
from gsgen.contract.errors import GsgenError
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.settings import Settings
from support.commands import gsgen_here
from support.reports.rules import crashing


def test_a_probe_that_breaks_a_rule_shows_its_rows_and_exits_1(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    dump = folder / "deep" / "out.npz"
    completed = gsgen_here(
        "repro", model, "--rule", "opacity-range", "--probe", "0", "--dump", dump
    )
    assert completed.code == 1, completed.err
    assert "GV003 error opacity-range" in completed.out
    assert "rows at probe no inputs:" in completed.out
    assert "5.02" in completed.out
    assert completed.out.index("reproduced: GV003 is broken") > completed.out.index("opacity")
    with np.load(dump) as arrays:
        (packed,) = [arrays[name] for name in arrays if arrays[name].shape[1:] == (10,)]
    assert packed[3, 3] == np.float32(5.02)


def test_a_rule_that_crashes_is_no_wrong_option(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (model,) = write(folder, "drift")
    registry = installed_rules()
    crashed = replace(registry.find("GM001"), check=crashing)
    monkeypatch.setitem(registry.rules, "GM001", crashed)
    completed = gsgen_here("repro", model, "--rule", "GM001")
    assert completed.code == 3, completed.out
    assert "GM001 was not checked" in completed.err
    assert "ZeroDivisionError" in completed.err


def test_without_a_probe_option_all_probes_are_checked(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    completed = gsgen_here("repro", model, "--rule", "GV003")
    assert completed.code == 1
    assert "rows at probe no inputs:" in completed.out


def test_the_document_has_the_finding_of_the_report_and_the_rows(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    completed = gsgen_here("repro", model, "--rule", "GV003", "--json")
    assert completed.code == 1
    document = json.loads(completed.out)
    report = json.loads(gsgen_here("validate", model, "--level", "values", "--json").out)
    expected = [finding for finding in report["findings"] if finding["rule"] == "GV003"]
    assert document["findings"] == expected
    assert (document["rule"], document["reproduced"]) == ("GV003", True)
    assert {row["row"]: row["opacity"] for row in document["rows"]}[3] == np.float32(5.02)


def test_a_rule_that_holds_exits_0(folder: Path) -> None:
    (model,) = write(folder, "drift")
    completed = gsgen_here("repro", model, "--rule", "GV003", "--probe", "time=0.286")
    assert completed.code == 0
    assert completed.out == f"does not reproduce: GV003 holds for {model} at probe time=0.286\n"


@pytest.mark.parametrize(
    ("name", "rule", "probe", "words"),
    [
        ("drift", "GV003", "time=2", "--probe: unknown probe 'time=2'"),
        ("drift", "GB001", "0", "several runs compared\n  Leave --probe out."),
        ("drift", "GI003", "0", "GI003 does not check single probes but the file"),
        ("drift", "TV101", None, "TV101 was not checked: only for target visionary"),
        ("trajectory", "GV003", None, "only for kind gaussian-generator"),
        ("view_flattened", "GV003", "0", "because GI001 does not hold"),
        ("view_flattened", "GV003", None, "because GI001 does not hold"),
    ],
)
def test_unchecked_rule_is_neither_failed_nor_passed(
    folder: Path, name: str, rule: str, probe: str | None, words: str
) -> None:
    (model,) = write(folder, name)
    actual = installed_rules().find(rule)
    with pytest.raises(GsgenError) as caught:
        reproduce(model, actual, Settings(), probe=probe)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("name", "rule", "code", "words"),
    [
        ("drift", "GV999", 2, "--rule: unknown rule 'GV999'"),
        ("drift", "TV101", 2, "TV101 was not checked: only for target visionary"),
        ("empty", "GV003", 4, "is empty (0 bytes)"),
    ],
)
def test_errors_have_their_own_exit_codes(
    folder: Path, name: str, rule: str, code: int, words: str
) -> None:
    write(folder, "drift")
    (folder / "empty.onnx").touch()
    completed = gsgen_here("repro", folder / f"{name}.onnx", "--rule", rule)
    assert completed.code == code, completed.out
    assert words in completed.err
    assert "Traceback" not in completed.err

"""Modules as authors of methods write them: exported with parity, or refused with a hint."""

from dataclasses import replace
from pathlib import Path

import pytest

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import export
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.rewriting.rewrite import graph_stats
from sdk.exporting.authored import MODULES, REFUSED, Cloud, Refusal
from support.models.captured import CAPTURED

pytestmark = pytest.mark.slow


EVERY_RELEASE = RewriteTarget.of(load_target("core"))
NEWEST_RELEASE = replace(
    EVERY_RELEASE, tables=tuple(t for t in EVERY_RELEASE.tables if "ep-webgpu" in t.runtime)
)
NOTES = {"LowPrecision": "autocast"}
STATIC = Settings(level=Level.STATIC)


def test_there_are_forty_modules_of_which_at_most_four_are_refused() -> None:
    assert len({*MODULES, *(refusal.module for refusal in REFUSED)}) == 40
    assert len(REFUSED) <= 4


# torch's encoder says at its construction that norm_first leaves out a fast path of its own.
@pytest.mark.filterwarnings("ignore:enable_nested_tensor is True:UserWarning")
@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_a_module_is_exported_with_parity_and_has_kernels_that_are_captured(
    module: type[Cloud], tmp_path: Path
) -> None:
    assert len(NEWEST_RELEASE.tables) == 1
    result = export(module(), tmp_path / "m.onnx", settings=STATIC, verify="quick")
    assert result.parity.holds
    assert result.parity.probes >= 2
    assert graph_stats(result.path, NEWEST_RELEASE).uncaptured == ()
    note = NOTES.get(module.__name__)
    assert (len(result.notes) == 1 and note in result.notes[0]) if note else result.notes == ()


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:enable_nested_tensor is True:UserWarning")
@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_an_authored_module_is_captured_live(module: type[Cloud], tmp_path: Path) -> None:
    report = export(module(), tmp_path / "m.onnx", settings=Settings(level=Level.LIVE)).report
    assert {rule: report.outcome(rule).status for rule in CAPTURED} == dict.fromkeys(
        CAPTURED, "pass"
    )


@pytest.mark.parametrize("refusal", REFUSED, ids=lambda refusal: refusal.module.__name__)
def test_a_refused_module_names_its_line_and_what_to_write(
    refusal: Refusal, tmp_path: Path
) -> None:
    with pytest.raises(GsgenError) as caught:
        export(refusal.module(), tmp_path / "m.onnx", settings=STATIC)
    assert refusal.hint in caught.value.hint
    assert "please report" not in caught.value.hint
    if refusal.has_line:
        assert "# guilty" in caught.value.where
    assert list(tmp_path.iterdir()) == []

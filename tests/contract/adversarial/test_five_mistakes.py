"""The five commonest mistakes, exported as a new user would: the first finding names each."""

import io
import re
import runpy
import sys
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

from support.reports.pages import DOCS, blocks

pytestmark = pytest.mark.slow


PAGE = DOCS / "guides" / "five-commonest-mistakes.md"
PICTURES = DOCS / "assets" / "mistakes"
MOST_BYTES = 40_000
# The rule that each mistake breaks, and words of its finding that name the mistake.
EXPECTED = {
    "HarmonicsAsInPly": ("GV048", "channel-major, as in a 3DGS PLY"),
    "CameraInverted": ("GB030", "centre were computed without the inverse rotation"),
    "CovariancesAtRest": ("GB042", "covariances of 600 of 600 rows stay as they were"),
    "QuaternionsInXyzw": ("GV041", "w x y z, not x y z w"),
    "SigmoidTwice": ("GV043", "as if the sigmoid were applied twice"),
}
RIGHT = ("Shell", "LitShell", "TurningShell")


@pytest.fixture(scope="module")
def findings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The printed lines about each model that the page's blocks export."""
    folder = tmp_path_factory.mktemp("mistakes")
    for block in blocks(PAGE):
        name = "find_mistakes.py" if block.mark == "five-mistakes" else block.mark
        (folder / name).write_text(block.text, "utf-8")
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, chdir(folder), redirect_stdout(output):
        patch.syspath_prepend(folder)
        runpy.run_path("find_mistakes.py", run_name="__main__")
        for name in ("mistakes", "shell"):
            del sys.modules[name]
    printed: dict[str, list[str]] = {}
    for line in output.getvalue().splitlines():
        if match := re.match(r"(\w+): (.*)", line):
            printed[match[1]] = [match[2]]
        else:
            printed[list(printed)[-1]].append(line.strip())
    return printed


def without_numbers(text: str) -> str:
    """Return a text without its numbers, which vary a little between releases of torch."""
    return re.sub(r"\d+(\.\d+)?", "#", " ".join(text.split()))


@pytest.mark.parametrize("name", EXPECTED)
def test_the_first_finding_names_the_mistake(name: str, findings: dict[str, list[str]]) -> None:
    rule, words = EXPECTED[name]
    _, first, hint, *_ = findings[name]
    assert first.startswith(f"{rule} ")
    assert words in f"{first} {hint}"


@pytest.mark.parametrize("name", EXPECTED)
def test_no_other_finding_comes_with_it(name: str, findings: dict[str, list[str]]) -> None:
    assert findings[name][0].endswith(", 1 findings")


@pytest.mark.parametrize("name", RIGHT)
def test_corrected_model_has_no_finding(name: str, findings: dict[str, list[str]]) -> None:
    assert findings[name] == ["conforms, 0 findings"]


@pytest.mark.parametrize("name", EXPECTED)
def test_the_page_shows_the_finding_as_it_is_printed(
    name: str, findings: dict[str, list[str]]
) -> None:
    page = PAGE.read_text("utf-8")
    (shown,) = re.findall(rf"<!-- finding: {name} -->\n```text\n(.*?)```", page, re.DOTALL)
    assert without_numbers(shown) == without_numbers(" ".join(findings[name][1:]))


@pytest.mark.parametrize("name", EXPECTED)
def test_the_page_shows_a_small_picture_of_right_and_wrong(name: str) -> None:
    path: Path = PICTURES / f"{name}.png"
    assert f"(../assets/mistakes/{name}.png)" in PAGE.read_text("utf-8")
    assert 0 < path.stat().st_size <= MOST_BYTES

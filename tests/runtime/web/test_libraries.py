"""Libraries within the browser client are those of npm, unchanged."""

from support.web.packages import package
from support.web.pages import CLIENT


def test_fzstd_is_that_of_npm_under_its_licence() -> None:
    folder = package("fzstd-0.1.1")
    held = (CLIENT / "fzstd.js").read_text("utf-8")
    notice, _, code = held.partition("// @ts-nocheck\n")
    assert code == (folder / "esm/index.mjs").read_text("utf-8")
    assert (folder / "LICENSE").read_text("utf-8").strip() in notice

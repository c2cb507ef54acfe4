"""Where uv searches for the packages that it installs in pip's stead."""

import subprocess
import sys

import pytest

from support.commands import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import install

PIP_CONFIG_LIST = """\
:env:.find-links='/wheels file:///more wheels'
global.cert='/certificates.pem'
global.extra-index-url='https://one.example/simple\\nhttps://two.example/simple'
global.find-links='/other'
global.index-url='https://global.example/simple'
install.index-url='https://install.example/simple'
"""


def test_uv_searches_where_pip_is_told_to() -> None:
    assert install.uv_settings(PIP_CONFIG_LIST) == {
        "UV_DEFAULT_INDEX": "https://install.example/simple",
        "UV_INDEX": "https://one.example/simple https://two.example/simple",
        "UV_FIND_LINKS": "/wheels,file:///more,wheels",
    }


def test_a_pip_without_settings_changes_nothing() -> None:
    assert install.uv_settings("") == {}


def test_pip_lists_its_settings_as_this_reads_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "https://mirror.example/simple")
    monkeypatch.setenv("PIP_FIND_LINKS", "/one /two")
    listed = subprocess.check_output([sys.executable, "-m", "pip", "config", "list"], text=True)
    settings = install.uv_settings(listed)
    assert settings["UV_DEFAULT_INDEX"] == "https://mirror.example/simple"
    assert settings["UV_FIND_LINKS"] == "/one,/two"


def test_pip_installs_where_uv_fails(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    called: list[list[str]] = []

    def run(command: list[object], **_: object) -> "subprocess.CompletedProcess[str]":
        called.append([str(part) for part in command])
        return subprocess.CompletedProcess(command, int("pip" in called[-1][1]), stdout="")

    monkeypatch.setattr(subprocess, "run", run)
    assert install.main(["torch==2.13.0"]) == 0
    assert "so pip does" in capfd.readouterr().err
    assert called[-1][1:4] == ["-m", "pip", "install"]
    assert called[-1][-1] == "torch==2.13.0"

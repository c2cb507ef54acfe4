"""Install packages into this environment, of the versions in constraints.txt.

usage: .venv/bin/python scripts/install.py -e '.[all]' --group dev

uv does it, which unpacks on every core and takes a sixth of pip's processor time. It searches where
pip is told to search. Where uv cannot be had or fails, pip installs.
"""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_PIP = (sys.executable, "-m", "pip")
_INSTALL = ("install", "--quiet", "--disable-pip-version-check", "-c", "constraints.txt")


def main(words: Sequence[str]) -> int:
    """Install what ``words`` name, as `pip install` understands them; return the exit code."""
    uv = Path(sys.executable).with_name("uv")
    if uv.exists() or _pip("--only-binary", ":all:", "uv") == 0:
        listed = subprocess.check_output(
            [*_PIP, "config", "list"],
            cwd=_ROOT,
            env=os.environ | {"PYTHONIOENCODING": "utf-8"},
            encoding="utf-8",
        )
        command = [uv, "pip", "install", "--quiet", "--python", sys.executable]
        command += ["--index-strategy", "unsafe-best-match", "-c", "constraints.txt", *words]
        environment = uv_settings(listed) | os.environ
        if subprocess.run(command, cwd=_ROOT, env=environment).returncode == 0:
            return 0
    print("install: uv did not install the packages, so pip does", file=sys.stderr)
    return _pip("pip>=25.1") or _pip("--no-compile", *words)  # older ones know no groups


def uv_settings(listed: str) -> dict[str, str]:
    """Return uv's variables for what `pip config list` prints: where packages are searched.

    pip obeys a variable before a file's section `install`, and that before `global`; it parts lists
    by white space.
    """
    settings: dict[str, list[str]] = {}
    for section in ("global", "install", ":env:"):
        pattern = rf"^{section}\.([\w-]+)=(.+)$"
        for name, value in re.findall(pattern, listed, re.MULTILINE):
            settings[name] = str(ast.literal_eval(value)).split()
    named = {
        "UV_DEFAULT_INDEX": " ".join(settings.get("index-url", ())),
        "UV_INDEX": " ".join(settings.get("extra-index-url", ())),
        "UV_FIND_LINKS": ",".join(settings.get("find-links", ())),
    }
    return {name: value for name, value in named.items() if value}


def _pip(*words: str) -> int:
    return subprocess.run([*_PIP, *_INSTALL, *words], cwd=_ROOT).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

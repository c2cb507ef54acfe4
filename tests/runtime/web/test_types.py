"""The TypeScript compiler agrees with the types in the browser client's comments."""

import json
import subprocess
from pathlib import Path

from support.web.packages import package
from support.web.pages import CLIENT

_OPTIONS = Path(__file__).parents[2] / "support/web/tsconfig.json"


def compiler_messages(folder: Path, work: Path) -> list[str]:
    """Return what TypeScript says about the JavaScript files of a folder."""
    compiler = package("typescript-5.9.3", needs_node=True) / "lib/tsc.js"
    types = package("types-0.1.74") / "dist/index.d.ts"
    config = work / "tsconfig.json"
    settings = {"extends": str(_OPTIONS), "include": [f"{folder}/*.js"], "files": [str(types)]}
    config.write_text(json.dumps(settings), "utf-8")
    command = ["node", str(compiler), "--project", str(config)]
    result = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    return result.stdout.splitlines()


def test_the_client_has_the_types_that_its_comments_say(tmp_path: Path) -> None:
    assert compiler_messages(CLIENT, tmp_path) == []


def test_a_wrong_type_is_found(tmp_path: Path) -> None:
    (tmp_path / "wrong.js").write_text('/** @type {GPUDevice} */\nexport const device = "one";\n')
    [message] = compiler_messages(tmp_path, tmp_path)
    assert "Type 'string' is not assignable to type 'GPUDevice'" in message

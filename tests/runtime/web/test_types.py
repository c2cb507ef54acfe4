"""The TypeScript compiler agrees with the types in the browser client's comments."""

import json
import subprocess
from pathlib import Path

import pytest

from support.web.packages import package
from support.web.pages import CLIENT

_OPTIONS = Path(__file__).parents[2] / "support/web/tsconfig.json"


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """What TypeScript says about the client, and about a wrong module, in one run of seconds."""
    compiler = package("typescript-5.9.3", needs_node=True) / "lib/tsc.js"
    types = package("types-0.1.74") / "dist/index.d.ts"
    types_folder = tmp_path_factory.mktemp("types")
    wrong = types_folder / "wrong.js"
    wrong.write_text('/** @type {GPUDevice} */\nexport const device = "one";\n')
    config = types_folder / "tsconfig.json"
    files = [str(types), str(wrong)]
    settings = {"extends": str(_OPTIONS), "include": [f"{CLIENT}/**/*.js"], "files": files}
    config.write_text(json.dumps(settings), "utf-8")
    command = ["node", str(compiler), "--project", str(config)]
    result = subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", cwd=config.parent
    )
    lines = result.stdout.splitlines()
    wrong_lines = [line for line in lines if line.startswith("wrong.js(")]
    return {"wrong": wrong_lines, "client": [line for line in lines if line not in wrong_lines]}


def test_the_client_has_the_types_that_its_comments_say(messages: dict[str, list[str]]) -> None:
    assert messages["client"] == []


def test_a_wrong_type_is_found(messages: dict[str, list[str]]) -> None:
    [message] = messages["wrong"]
    assert "Type 'string' is not assignable to type 'GPUDevice'" in message

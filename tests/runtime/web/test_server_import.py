"""Servers that render pages import the client, and have neither a document nor a GPU."""

import subprocess

from support.web.packages import package
from support.web.pages import CLIENT

_WORKER = "reader_worker.js"  # a program of its own, which no module imports
_SCRIPT = """
const failed = [];
for (const file of process.argv.slice(1)) {
  await import(file).catch((error) => failed.push(`${file}: ${error.message}`));
}
console.log(failed.join("\\n"));
"""


def test_every_module_is_imported_without_a_document() -> None:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    modules = set(CLIENT.glob("*.js")) - {CLIENT / _WORKER}
    files = sorted(path.as_uri() for path in modules)
    assert len(files) > 30
    command = ["node", "--input-type=module", "--eval", _SCRIPT, *files]
    result = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert result.stderr == ""
    assert result.stdout.strip() == ""

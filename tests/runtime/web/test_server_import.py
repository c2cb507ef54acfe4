"""Servers that render pages import the client, and have neither a document nor a GPU."""

import subprocess

from support.web.packages import package
from support.web.pages import CLIENT

_WORKERS = {"bundled_worker.js", "reader_worker.js"}  # programs of their own
_SCRIPT = """
const failed = [];
for (const file of process.argv.slice(1)) {
  await import(file).catch((error) => failed.push(`${file}: ${error.message}`));
}
console.log(failed.join("\\n"));
"""


def test_every_module_is_imported_without_a_document() -> None:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    modules = set(CLIENT.glob("*.js")) - {CLIENT / name for name in _WORKERS}
    files = sorted(path.as_uri() for path in modules)
    assert len(files) > 30
    command = ["node", "--input-type=module", "--eval", _SCRIPT, *files]
    result = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert result.stderr == ""
    assert result.stdout.strip() == ""

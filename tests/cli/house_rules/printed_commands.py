"""Runs many command lines in one process, whose stdout and stderr are as their creator chose.

Reads a JSON list of command lines from the file that its argument names. After the output of each
it writes a record separator, the exit code, and a unit separator, all of them ASCII.
"""

import json
import os
import sys
from pathlib import Path
from unittest.mock import patch

from gsgen.cli.app import main


def run(words: list[str]) -> int:
    try:
        with patch.object(sys, "argv", ["gsgen", *words]):
            main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    return 0


if __name__ == "__main__":
    for line in json.loads(Path(sys.argv[1]).read_text("utf-8")):
        # As the interpreter decodes its arguments, which is not UTF-8 in every locale.
        code = run([os.fsdecode(word.encode()) for word in line])
        sys.stderr.flush()
        sys.stdout.flush()
        sys.stdout.buffer.write(f"\x1e{code}\x1f".encode("ascii"))
        sys.stdout.buffer.flush()

"""A worker of the fuzzer that hangs at case 1 and dies at case 2, for tests."""

import json
import os
import sys
import time

_FACTS = {"verdict": "conforms", "ran": False, "mutations": [], "seconds": 0.0}


def _say(**message: object) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _say(ready=1)
    for line in sys.stdin:
        if line.strip() == "1":
            time.sleep(600)
        if line.strip() == "2":
            sys.stderr.write("no luck")
            sys.stderr.flush()
            os.abort()
        _say(case=int(line), failures=[], **_FACTS)

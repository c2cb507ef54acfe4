"""The JSON Schema of SARIF 2.1.0, as others publish it."""

import json
from pathlib import Path

_FILE = Path(__file__).parents[2] / "contract" / "data" / "sarif-2.1.0-rtm.5.json"
SCHEMA = json.loads(_FILE.read_text("utf-8"))

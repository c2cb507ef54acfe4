"""Write the published JSON Schemas of manifests and reports from their dataclasses.

Run it after a change to `gsgen.contract.spec.manifest` or `gsgen.contract.reporters.document`:
.venv/bin/python scripts/write_schemas.py
"""

import json
import sys
from pathlib import Path

from gsgen.contract.reporters.document import schema
from gsgen.contract.spec.manifest_io import schemas
from gsgen.contract.validation.report import REPORT_SCHEMA_FILE

FOLDER = Path(__file__).parents[1] / "contract/gsgen/contract/schemas"


def main(folder: Path = FOLDER) -> None:
    """Write one schema file per kind of manifest, and one for reports, into ``folder``."""
    for name, document in {**schemas(), REPORT_SCHEMA_FILE: schema()}.items():
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        (folder / name).write_text(text, "utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))

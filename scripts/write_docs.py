"""Generate the parts of the documentation that repeat facts of the code, and the JSON Schemas.

New statements of the specification get their numbers.

A part of a page is between two comments; the text after the colon names the part:

    <!-- generated: roles gaussian-generator -->
    …
    <!-- end generated -->

Run the script after a change to the contract: .venv/bin/python scripts/write_docs.py
With --check it writes no file, lists outdated pages, and exits 1 if there are any.
"""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

from docs_parts import (
    commands,
    contract,
    formats,
    manifest,
    passes,
    report,
    rooms,
    rules,
    runs,
    statements,
    viewer_kit,
)
from docs_parts.pages import tutorial

from gsgen.conformance.viewer_kit.document import viewer_kit_schemas
from gsgen.contract.reporters.document import schema
from gsgen.contract.reporters.rule_pages import index
from gsgen.contract.spec.manifest_io import schemas
from gsgen.contract.validation.report import REPORT_SCHEMA_FILE
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION as NEURAL_TILE
from gsgen.tiles.format.neural_tile import neural_schema

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

Part = Callable[..., str]

# First word of a marker → the function that writes its text, called with its other words.
PARTS: dict[str, Part] = {
    "command": commands.command,
    "commands": commands.overview,
    "commands-besides": commands.besides,
    "config-keys": contract.config_keys,
    "kinds": manifest.kinds,
    "field-mutations": contract.field_mutations,
    "fields": manifest.fields,
    "limits": contract.limits,
    "operator-profiles": contract.operator_profiles,
    "plugin-commands": commands.plugins,
    "plugin-list": commands.plugin_list,
    "plugins": commands.plugin_table,
    "probes": contract.probes,
    "report-fields": report.fields,
    "roles": contract.roles,
    "rooms": rooms.table,
    "row": contract.row,
    "rows-of-color": contract.rows_of_color,
    "rules-by-level": rules.by_level,
    "run": runs.run,
    "severities": contract.severities,
    "splat-formats": formats.splat_formats,
    "targets": contract.targets,
    "tolerances": contract.tolerances,
    "viewer-kit-cases": viewer_kit.cases,
    "viewer-kit-faults": viewer_kit.faults,
    "waiver-keys": contract.waiver_keys,
}

_MARKED = re.compile(
    r"(<!-- generated: (?P<name>[^>]+?) -->\n).*?(<!-- end generated -->)", re.DOTALL
)


def fill(text: str) -> str:
    """Return the text of a page with current generated parts."""

    def generated_part(match: "re.Match[str]") -> str:
        name, *words = match["name"].split()
        return f"{match[1]}\n{PARTS[name](*words).strip()}\n\n{match[3]}"

    return _MARKED.sub(generated_part, text)


def generated() -> dict[Path, str]:
    """Return the current content of every file that is generated, wholly or in part."""
    registry = rules.ours()
    pages = {DOCS / "rules" / f"{rule.id}.md": rules.page(rule) for rule in registry.rules.values()}
    pages[DOCS / "tutorial.md"] = tutorial.page()
    pages[DOCS / "rules" / "index.md"] = index(registry)
    pages |= {
        DOCS / "passes" / f"{rewrite.name}.md": passes.page(rewrite) for rewrite in passes.REWRITES
    }
    pages[DOCS / "passes" / "index.md"] = passes.index()
    published = {**schemas(), REPORT_SCHEMA_FILE: schema(), **viewer_kit_schemas()}
    published[f"{NEURAL_TILE}.schema.json"] = neural_schema()
    for name, document in published.items():
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        pages[DOCS / "spec" / "schemas" / name] = text
    for name, document in {**schemas(), REPORT_SCHEMA_FILE: schema()}.items():
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        pages[ROOT / "contract/gsgen/contract/schemas" / name] = text
    statement_pages = statements.pages(DOCS / "spec")
    for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))):
        text = statement_pages.get(path, path.read_text("utf-8"))
        if path not in pages and (path in statement_pages or "<!-- generated: " in text):
            pages[path] = fill(text)
    return pages


def orphans(current: dict[Path, str]) -> list[Path]:
    """Return pages of rules and of passes that no longer exist."""
    pages = [*(DOCS / "rules").glob("*.md"), *(DOCS / "passes").glob("*.md")]
    return sorted(path for path in pages if path not in current)


def main(arguments: list[str]) -> int:
    """Write the outdated files, or only list them; return the exit code."""
    pages = generated()
    stale = [
        path
        for path, text in pages.items()
        if not path.is_file() or path.read_text("utf-8") != text
    ]
    orphaned = orphans(pages)
    listed = "".join(f"{path.relative_to(ROOT)}\n" for path in [*stale, *orphaned])
    sys.stdout.write(listed)
    if "--check" in arguments:
        return int(bool(listed))
    for path in stale:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(pages[path], "utf-8")
    for path in orphaned:
        path.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

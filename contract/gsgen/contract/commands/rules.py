"""`gsgen rules`: list the catalogue."""

__all__ = ["rules"]

import json
from pathlib import Path
from typing import Annotated

import typer


def rules(
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    pages: Annotated[
        Path | None,
        typer.Option("--pages", help="Write one Markdown page a rule into this folder."),
    ] = None,
) -> None:
    """List every rule: id, severity, level, name and what must hold."""
    from gsgen.contract.commands.output import write_text
    from gsgen.contract.installed import installed_rules
    from gsgen.contract.rule_pages import index, page, to_dict

    registry = installed_rules()
    if pages is not None:
        for one in registry.rules.values():
            write_text(pages / f"{one.id.replace('/', '-')}.md", page(one, registry))
        write_text(pages / "index.md", index(registry))
        typer.echo(f"{len(registry.rules)} pages in {pages}")
        return
    if as_json:
        made = [to_dict(one) for one in registry.rules.values()]
        typer.echo(json.dumps(made, indent=2, ensure_ascii=False))
        return
    for one in registry.rules.values():
        head = f"{one.id}  {one.severity.word:<7}  {one.level.word:<9}  {one.slug}"
        typer.echo(f"{head}\n    {one.what}")

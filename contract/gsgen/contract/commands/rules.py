"""`gsgen rules`: list the catalogue."""

__all__ = ["rules"]

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.errors import UnknownName

if TYPE_CHECKING:
    from gsgen.contract.validation.rule import Registry, Rule


def rules(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WORD]...",
            help="Only rules of an id that begins so (GV), or with this word in name or text.",
            show_default="all",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    pages: Annotated[
        Path | None,
        typer.Option("--pages", help="Write one Markdown page a rule into this folder."),
    ] = None,
) -> None:
    """List every rule: id, severity, level, name and what must hold.

    Exits 2 if no rule has a given word.
    """
    from gsgen.contract.commands.output import write_text
    from gsgen.contract.reporters.rule_pages import index, page, to_dict
    from gsgen.contract.rules.catalogue import installed_rules

    registry = installed_rules()
    chosen = _chosen(registry, words) if words else list(registry.rules.values())
    if pages is not None:
        for one in registry.rules.values():
            write_text(pages / f"{one.id.replace('/', '-')}.md", page(one, registry))
        write_text(pages / "index.md", index(registry))
        typer.echo(f"{len(registry.rules)} pages in {pages}")
        return
    if as_json:
        made = [to_dict(one) for one in chosen]
        typer.echo(json.dumps(made, indent=2, ensure_ascii=False))
        return
    for one in chosen:
        head = f"{one.id}  {one.severity.word:<7}  {one.level.word:<9}  {one.slug}"
        typer.echo(f"{head}\n    {one.statement}")


def _chosen(registry: "Registry", words: list[str]) -> "list[Rule]":
    """Return the rules that any of ``words`` speaks of, in the order of the catalogue.

    Raises:
        UnknownName: No rule has one of them.
    """
    chosen: set[str] = set()
    for word in words:
        found = [one.id for one in registry.rules.values() if _speaks_of(word, one)]
        if not found:
            names = [one.slug for one in registry.rules.values()]
            raise UnknownName.among("rule", word, names, "WORD")
        chosen |= set(found)
    return [one for one in registry.rules.values() if one.id in chosen]


def _speaks_of(word: str, rule: "Rule") -> bool:
    seen = word.casefold()
    return (
        rule.id.casefold().startswith(seen)
        or seen in f"{rule.slug} {rule.statement}".casefold()
    )

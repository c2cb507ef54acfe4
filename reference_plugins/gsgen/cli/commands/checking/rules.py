"""The command `gsgen rules`, which lists the installed validation rules."""

__all__ = ["rules"]

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import UnknownName

if TYPE_CHECKING:
    from gsgen.contract.validation.rule import Registry, Rule


def rules(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WORD]...",
            help="Only rules whose id starts with WORD (GV), or whose name or text contains it.",
            show_default="all",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
    pages: Annotated[
        Path | None,
        typer.Option("--pages", help="Write one Markdown page per rule into this folder."),
    ] = None,
) -> None:
    """List every validation rule: id, severity, level, name and statement.

    Exits 2 if no rule matches a WORD.
    """
    from gsgen.cli.commands.checking.validate_file import every_rule
    from gsgen.cli.output import write_text
    from gsgen.conformance.fixtures import example_model_of_rule
    from gsgen.contract.reporters.rule_pages import index, page, to_dict

    registry = every_rule()
    selected = _selected_rules(registry, words) if words else list(registry.rules.values())
    if pages is not None:
        for rule in registry.rules.values():
            write_text(
                pages / f"{rule.id.replace('/', '-')}.md",
                page(rule, registry, example_model_of_rule(rule.id)),
            )
        write_text(pages / "index.md", index(registry))
        echo(f"{len(registry.rules)} pages in {pages}")
        return
    if as_json:
        document = [to_dict(rule, example_model_of_rule(rule.id)) for rule in selected]
        echo_json(document)
        return
    for rule in selected:
        headline = f"{rule.id}  {rule.severity.word:<7}  {rule.level.word:<9}  {rule.slug}"
        echo(headline, f"    {rule.statement}")


def _selected_rules(registry: "Registry", words: list[str]) -> "list[Rule]":
    """Return the validation rules that match any of the search ``words``, in catalogue order."""
    selected_ids: set[str] = set()
    for word in words:
        ids = [rule.id for rule in registry.rules.values() if _matches_rule(word, rule)]
        if not ids:
            names = [rule.slug for rule in registry.rules.values()]
            raise UnknownName.among("rule", word, names, "WORD")
        selected_ids |= set(ids)
    return [rule for rule in registry.rules.values() if rule.id in selected_ids]


def _matches_rule(word: str, rule: "Rule") -> bool:
    folded_word = word.casefold()
    return (
        rule.id.casefold().startswith(folded_word)
        or folded_word in f"{rule.slug} {rule.statement}".casefold()
    )

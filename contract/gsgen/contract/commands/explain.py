"""`gsgen explain`: what a rule wants, why, and how to mend a model that breaks it."""

__all__ = ["explain"]

from typing import Annotated

import typer


def explain(
    rules: Annotated[
        list[str],
        typer.Argument(
            metavar="RULE...",
            help="A rule's id or name, such as GV003 or opacity-range.",
            show_default=False,
        ),
    ],
) -> None:
    """Say what RULE wants, why, and how to mend a model that breaks it."""
    from gsgen.contract.reporters.rule_pages import page
    from gsgen.contract.rules.catalogue import installed_rules

    registry = installed_rules()
    found = [registry.find(name) for name in rules]
    typer.echo("\n".join(page(one, registry) for one in found))

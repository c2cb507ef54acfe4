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
    from gsgen.contract.installed import installed_rules
    from gsgen.contract.rule_pages import page

    registry = installed_rules()
    found = [registry.find(name) for name in rules]
    typer.echo("\n".join(page(one, registry) for one in found))

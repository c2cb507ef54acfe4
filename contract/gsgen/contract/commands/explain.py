"""`gsgen explain`: what a rule wants, why, and how to mend a model that breaks it."""

__all__ = ["explain"]

from typing import Annotated

import typer


def explain(
    rule: Annotated[
        str, typer.Argument(help="A rule's id or name, such as GV003 or opacity-range.")
    ],
) -> None:
    """Say what RULE wants, why, and how to mend a model that breaks it."""
    from gsgen.contract.installed import installed_rules
    from gsgen.contract.rule_pages import page

    registry = installed_rules()
    typer.echo(page(registry.find(rule), registry))

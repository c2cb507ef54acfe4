"""The command `gsgen explain`, which prints the documentation pages of rules."""

__all__ = ["explain"]

from typing import Annotated

import typer

from gsgen.cli.options import complete_rules
from gsgen.cli.output import echo_json, echo_text


def explain(
    rules: Annotated[
        list[str],
        typer.Argument(
            metavar="RULE...",
            help="A rule's id or name, such as GV003 or opacity-range.",
            show_default=False,
            autocompletion=complete_rules,
        ),
    ],
    *,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print as JSON, as `gsgen rules --json` does.")
    ] = False,
) -> None:
    """Explain what the rule RULE requires, why, and how to repair a model that breaks it."""
    from gsgen.cli.commands.checking.validate_file import every_rule
    from gsgen.conformance.fixtures import example_model_of_rule
    from gsgen.contract.reporters.rule_pages import page, to_dict

    registry = every_rule()
    entries = [registry.find(name) for name in rules]
    if as_json:
        document = [to_dict(entry, example_model_of_rule(entry.id)) for entry in entries]
        echo_json(document)
        return
    echo_text(
        "\n".join(page(entry, registry, example_model_of_rule(entry.id)) for entry in entries)
    )

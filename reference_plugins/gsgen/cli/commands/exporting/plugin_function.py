"""Makes the typer function behind `gsgen export NAME` from a plugin's declaration."""

__all__ = ["plugin_function"]

from collections.abc import Callable
from typing import Any

from gsgen.cli.commands.exporting.export_options import with_common_options
from gsgen.sdk.plugins.plugin import Plugin


def plugin_function(plugin: Plugin) -> Callable[..., Any]:
    """Return the typer function behind `gsgen export NAME`, with every option.

    Raises:
        TypeError: A parameter of the plugin has the name of an option of every export.
    """
    if plugin.command is not None:
        return plugin.command
    assert plugin.build is not None
    from gsgen.cli.commands.exporting.export_job import run_export
    from gsgen.sdk.plugins.factory import locate_errors

    # An exception of one of our own plugins is a fault of gsgen, and stays a crash.
    is_reference_plugin = plugin.build.__module__.partition(".")[0] == "gsgen"

    return with_common_options(
        plugin.build,
        lambda build, request: run_export(
            build if is_reference_plugin else locate_errors(build, plugin.name),
            request,
            plugin.name,
        ),
    )

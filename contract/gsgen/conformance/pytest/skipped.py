"""Skips the remaining tests of a class if building or reading its model fails.

Every test of such a class would raise the same error. One report shows the fault; a hundred and
forty hide it.
"""

__all__ = ["record_unusable_model", "skip_if_unusable", "uses_model"]

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract.errors import GsgenError

_UNTESTABLE_KEY = pytest.StashKey[dict[object, str]]()
_LOG_SECTION = "Captured log"
_EXPORTER_LOG_PREFIX = "DEBUG    torch."  # log lines of torch's exporter for its own developers


def uses_model(item: pytest.Item) -> bool:
    """Return whether a test of a ``GeneratorConformance`` class uses a validation result."""
    module = sys.modules.get("gsgen.conformance.pytest.generator")
    test_class = getattr(item, "cls", None)
    if (
        module is None
        or test_class is None
        or not issubclass(test_class, module.GeneratorConformance)
    ):
        return False
    return "conformance" in getattr(item, "fixturenames", ())


def skip_if_unusable(item: pytest.Item) -> None:
    """Skip a test if an earlier test has recorded that its model cannot be validated."""
    first = item.session.stash.get(_UNTESTABLE_KEY, {}).get(_model_key(item))
    if first is not None:
        pytest.skip(f"the model cannot be validated: see the error of {first}")


def record_unusable_model(
    item: pytest.Item, call: pytest.CallInfo[None], report: pytest.TestReport
) -> None:
    """Record that a model cannot be validated, and cut library code from the pytest traceback."""
    assert call.excinfo is not None
    if "conformance" in getattr(item, "funcargs", {}):
        return  # the model was validated, and the rule crashed
    item.session.stash.setdefault(_UNTESTABLE_KEY, {})[_model_key(item)] = item.name
    filtered_sections = [
        (head, _without_exporter_logs(head, text)) for head, text in report.sections
    ]
    report.sections = [(head, text) for head, text in filtered_sections if text]
    if isinstance(call.excinfo.value, GsgenError):
        report.longrepr = call.excinfo.getrepr(style="value")
        report.sections.insert(0, ("Where", "\n".join(_traceback_lines(item, call.excinfo))))


def _model_key(item: pytest.Item) -> object:
    """Return a key of the model that a test uses: the test's class and fixture parameters."""
    indices = getattr(getattr(item, "callspec", None), "indices", {})
    remaining = sorted((name, index) for name, index in indices.items() if name != "rule")
    return getattr(item, "cls", None), tuple(remaining)


def _without_exporter_logs(head: str, text: str) -> str:
    if not head.startswith(_LOG_SECTION):
        return text
    return "\n".join(
        line for line in text.splitlines() if not line.startswith(_EXPORTER_LOG_PREFIX)
    )


def _traceback_lines(
    item: pytest.Item, excinfo: pytest.ExceptionInfo[BaseException]
) -> Iterator[str]:
    """Yield the traceback lines of an error that lie in the test author's code, outermost first."""
    root = item.config.rootpath
    for entry in excinfo.traceback:
        name = str(entry.frame.f_globals.get("__name__", ""))
        path = Path(entry.path)
        is_library_code = name.startswith("gsgen.") or "site-packages" in path.parts
        if not is_library_code and path.is_relative_to(root):
            line = str(entry.statement).strip()
            yield f"{path.relative_to(root)}:{entry.lineno + 1}: {line}"

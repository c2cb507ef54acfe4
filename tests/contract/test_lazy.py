"""Lazy imports: where a package finds its public names."""

import sys
from pathlib import Path

import pytest

INIT = """
from typing import TYPE_CHECKING
from gsgen.contract._lazy import lazy_getattr

if TYPE_CHECKING:
    import os.path
    from . import part
    from lazy_package.part import value

__all__ = ["value", "other"]
__getattr__ = lazy_getattr(__name__)
"""


def test_other_imports_for_type_checkers_are_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "lazy_package"
    folder.mkdir()
    (folder / "__init__.py").write_text(INIT)
    (folder / "part.py").write_text("value = 3")
    monkeypatch.syspath_prepend(tmp_path)
    import lazy_package

    assert "lazy_package.part" not in sys.modules
    assert lazy_package.value == 3
    with pytest.raises(AttributeError, match="'lazy_package' has no attribute 'part_of'"):
        lazy_package.part_of  # noqa: B018

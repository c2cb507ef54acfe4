"""Lazy imports: where a package finds its public names."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

INIT = """
from typing import TYPE_CHECKING
from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    import os.path
    from . import part
    from lazy_package.part import value

__all__ = ["value", "other"]
__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
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

    assert dir(lazy_package) == ["other", "value"]
    assert "lazy_package.part" not in sys.modules
    assert lazy_package.value == 3
    with pytest.raises(AttributeError, match="'lazy_package' has no attribute 'part_of'"):
        lazy_package.part_of  # noqa: B018


@pytest.mark.parametrize("package", ["gsgen.contract", "gsgen.sdk", "gsgen.runtime"])
def test_a_package_lists_its_public_names(package: str) -> None:
    module = import_module(package)
    assert dir(module) == sorted(module.__all__)

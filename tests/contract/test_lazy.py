"""Public names that a package imports when they are first used."""

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

PACKAGES = (
    "gsgen.contract", "gsgen.conformance", "gsgen.formats", "gsgen.reference_plugins.synthetic",
    "gsgen.runtime", "gsgen.runtime.baking", "gsgen.sdk", "gsgen.sdk.binding", "gsgen.tiles",
)  # fmt: skip


@pytest.mark.parametrize("package", PACKAGES)
def test_lazy_names_agree_with_type_checking_imports(package: str) -> None:
    module = import_module(package)
    assert module.__file__ is not None
    module_by_name: dict[str, str] = {}
    for block in ast.parse(Path(module.__file__).read_text("utf-8")).body:
        for node in block.body if isinstance(block, ast.If) else ():
            assert isinstance(node, ast.ImportFrom)
            module_by_name |= {alias.name: str(node.module) for alias in node.names}
    assert module._MODULE_BY_NAME.keys() == module_by_name.keys()
    for name, home_module in module._MODULE_BY_NAME.items():
        assert home_module in (
            module_by_name[name],
            f"{module_by_name[name]}.{name}",
        )  # which is a module itself
    assert set(module_by_name) <= set(module.__all__)
    assert dir(module) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match=f"'{package}' has no attribute 'part_of'"):
        module.part_of  # noqa: B018


def test_a_lazy_package_imports_no_module_of_its_own() -> None:
    code = (
        "import sys, gsgen.contract; "
        "print(*(name for name in sys.modules if name.startswith('gsgen')))"
    )
    completed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert completed.stdout.split() == ["gsgen", "gsgen.contract"]

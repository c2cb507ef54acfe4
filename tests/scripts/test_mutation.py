"""`make mutants`: which mutants count, how functions change in place, and which tests are near."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from support.commands import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
from mutation.patching import changed_functions, index_functions, patch
from mutation.sampling import Mutant, is_equivalent
from mutation.selection import SuiteFiles, definitions_at, parameter_words

CODE = """
from dataclasses import dataclass

LIMIT = 3

def outer(x: int) -> int:
    def inner(y):
        return y + 1
    return inner(x)

class Box:
    size = 2
    def area(self):
        return self.size * self.size
"""


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("def f(x: int | None): pass", "def f(x: int & None): pass"),
        ("x: tuple[1, 2] = 0", "x: tuple[1, 3] = 0"),
        ("__all__ = ['a' + 'b']", "__all__ = ['a' - 'b']"),
        ("raise E(f'{n + 1} rows')", "raise E(f'{n - 1} rows')"),
        ("@cache\ndef f(): pass", "def f(): pass"),
        ("zip(a, b, strict=True)", "zip(a, b, strict=False)"),
        ("x is None", "x == None"),
        ("if TYPE_CHECKING:\n    import a", "if not TYPE_CHECKING:\n    import a"),
        ("def f(*, a): pass", "def f(^, a): pass"),
        ("def f(a, b=1, *, c, d=2): pass", "def f(a, b=1, /, c, d=2): pass"),
        ("def f(a, *, c): pass", "def f(a, /, c): pass"),
    ],
)
def test_what_no_test_can_notice_is_no_mutant(before: str, after: str) -> None:
    assert is_equivalent(before, after)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("x = a + 1", "x = a - 1"),
        ("x is y", "x == y"),
        ("raise E(n + 1)", "raise E(n - 1)"),
        ("@rule\ndef f(): pass", "def f(): pass"),
        ("f(deep=True)", "f(deep=False)"),
        ("def f(a, *, b=1): pass", "def f(a, *, b=2): pass"),
    ],
)
def test_what_changes_a_result_is_a_mutant(before: str, after: str) -> None:
    assert not is_equivalent(before, after)


@pytest.fixture
def module(tmp_path: Path) -> ModuleType:
    (tmp_path / "patched.py").write_text(CODE, "utf-8")
    spec = importlib.util.spec_from_file_location("patched", tmp_path / "patched.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("old", "new"), [("y + 1", "y - 1"), ("* self.size", "+ self.size * 3")])
def test_a_function_changes_in_place(module: ModuleType, old: str, new: str) -> None:
    file = str(module.__file__)
    changes = changed_functions(CODE, CODE.replace(old, new), file)
    assert changes is not None
    assert len(changes) == 1
    area = module.Box().area  # bound before the change
    assert patch(changes, index_functions(str(Path(file).parent)))
    assert (module.outer(5), area()) == ((4, 4) if "y" in old else (6, 8))


@pytest.mark.parametrize("old", ["LIMIT = 3", "size = 2", "def outer(x: int)"])
def test_code_that_runs_at_import_needs_a_new_process(old: str) -> None:
    changed = {"LIMIT = 3": "LIMIT = 4", "size = 2": "size = 9"}.get(old, "def outer(x: int = 7)")
    assert changed_functions(CODE, CODE.replace(old, changed), "patched.py") is None


def test_a_function_that_does_not_live_is_told(module: ModuleType) -> None:
    changes = changed_functions(CODE, CODE.replace("y + 1", "y - 1"), "elsewhere.py")
    assert changes is not None
    assert not patch(changes, index_functions(str(Path(str(module.__file__)).parent)))


@pytest.fixture(scope="module")
def suite() -> SuiteFiles:
    return SuiteFiles(ROOT)


def test_the_nearest_tests_name_or_import_what_changed(suite: SuiteFiles) -> None:
    path = Path("runtime/gsgen/runtime/renderer/bands.py")
    line = (ROOT / path).read_text("utf-8").split("def draw_bands")[0].count("\n") + 3
    mutant = Mutant(path, "operator", "", f"    @@ -{line} +{line} @@")
    assert definitions_at((ROOT / path).read_text("utf-8"), mutant.diff) == {"draw_bands"}
    nearest = suite.nearest(mutant)
    assert nearest[0] == "tests/runtime/renderer/test_bands.py"
    assert "tests/runtime/renderer/test_limits.py" in nearest


def test_tests_that_use_a_constant_are_near_to_it(suite: SuiteFiles) -> None:
    path = Path("sdk/gsgen/sdk/passes/framework/value_facts.py")
    code = (ROOT / path).read_text("utf-8")
    line = code.split("\nUNBOUNDED_END = ")[0].count("\n") + 2
    mutant = Mutant(path, "operator", "", f"    @@ -{line} +{line} @@")
    assert definitions_at(code, mutant.diff) == {"UNBOUNDED_END"}
    nearest = suite.nearest(mutant)
    assert "tests/sdk/passes/rows/test_row_gathers.py" in nearest


def test_tests_whose_parameters_name_a_rule_are_near_to_it() -> None:
    path = Path("contract/gsgen/contract/rules/interface/avatar_inputs.py")
    code = (ROOT / path).read_text("utf-8")
    line = code.split("def _order_faults")[0].count("\n") + 2
    node_id = "tests/contract/rules/test_corpus.py::test_rules[GI030-joint_before_parent]"
    suite = SuiteFiles(ROOT, [node_id])
    mutant = Mutant(path, "operator", "", f"    @@ -{line} +{line} @@")
    corpus = "tests/contract/rules/test_corpus.py"
    assert corpus in suite.nearest(mutant)[:2]
    assert corpus not in SuiteFiles(ROOT).nearest(mutant)[:2]
    assert not suite.parameters(mutant).isdisjoint(parameter_words(node_id))
    assert suite.parameters(mutant).isdisjoint(parameter_words(node_id.replace("GI030", "GI001")))


def test_tests_that_run_a_command_are_near_to_it(suite: SuiteFiles) -> None:
    path = Path("reference_plugins/gsgen/cli/commands/checking/diff.py")
    mutant = Mutant(path, "operator", "", "    @@ -59 +59 @@")
    near = suite.nearest(mutant)
    assert near[0] == "tests/cli/validating/test_diff.py"
    assert "tests/cli/house_rules/test_exit_codes.py" in near

from importlib import import_module

import pytest

from gsgen.contract.errors import ExitCode, GsgenError, InputUnreadable, UnknownName

HOMES = {
    "rule": ("validation.rule", "validation.finding", "validation.level_backend"),
    "layout": ("spec.layout",),
    "manifest": ("spec.manifest",),
}


@pytest.mark.parametrize("door", HOMES)
def test_a_public_module_exports_every_name_that_it_lists(door):
    module = import_module(f"gsgen.contract.{door}")
    assert [name for name in module.__all__ if not hasattr(module, name)] == []


@pytest.mark.parametrize("door", ["layout", "manifest"])
def test_a_public_module_has_every_name_of_its_home(door):
    module = import_module(f"gsgen.contract.{door}")
    for home_module in HOMES[door]:
        original = import_module(f"gsgen.contract.{home_module}")
        for name in original.__all__:
            assert getattr(module, name) is getattr(original, name)
            assert name in module.__all__


def test_authors_of_rules_get_the_types_that_their_checks_receive():
    door = import_module("gsgen.contract.rule")
    expected_types = {"InspectedModel", "ProbeRuns", "ModelOutputs", "Rows", "Behaviour", "Review"}
    assert expected_types <= set(door.__all__)


def test_exit_codes_are_those_that_scripts_rely_on():
    assert {code.name: int(code) for code in ExitCode} == {
        "SUCCESS": 0,
        "FAILURE": 1,
        "USAGE": 2,
        "INTERNAL": 3,
        "UNREADABLE": 4,
        "TERMINAL_HANGUP": 129,
        "INTERRUPTED": 130,
        "TERMINATED": 143,
    }


@pytest.mark.parametrize(
    ("kind", "code"), [(GsgenError, 2), (UnknownName, 2), (InputUnreadable, 4)]
)
def test_an_error_has_the_exit_code_of_its_kind(kind, code):
    assert kind("message").exit_code == code

import pytest

from gsgen.contract._entry_points import registered


def test_what_a_group_holds_comes_by_name():
    names = [point.name for point in registered("gsgen.commands")]
    assert "validate" in names
    assert names == sorted(names)
    assert {point.group for point in registered("gsgen.commands")} == {"gsgen.commands"}


@pytest.mark.parametrize("group", ["gsgen.nothing", "gsgen", ""])
def test_a_group_that_nobody_registers_in_is_empty(group):
    assert registered(group) == []

import pytest

from gsgen.contract._entry_points import registered_entry_points


def test_entry_points_of_a_group_are_keyed_by_name():
    names = [point.name for point in registered_entry_points("gsgen.generators")]
    assert "scaffold-gs" in names
    assert names == sorted(names)
    assert {point.group for point in registered_entry_points("gsgen.generators")} == {
        "gsgen.generators"
    }


@pytest.mark.parametrize("group", ["gsgen.nothing", "gsgen", ""])
def test_a_group_that_nobody_registers_in_is_empty(group):
    assert registered_entry_points(group) == []

"""Folders of too many modules."""

import pytest


@pytest.mark.parametrize(("count", "passed"), [(1, True), (15, True), (16, False), (40, False)])
@pytest.mark.parametrize("folder", ["sdk/gsgen/sdk/room", "tests/support", "scripts/parts"])
def test_a_folder_holds_at_most_fifteen_modules(measure, folder, count, passed):
    modules = {f"{folder}/module_{number}.py": "" for number in range(count)}
    result = measure("folders", {f"{folder}/__init__.py": "", **modules})
    assert result.passed is passed
    assert [(violation.path, violation.subject) for violation in result.violations] == (
        [] if passed else [(folder, str(count))]
    )


def test_folders_inside_of_a_folder_count_for_themselves(measure):
    modules = {f"sdk/{room}/m{number}.py": "" for room in "ab" for number in range(15)}
    assert measure("folders", modules).passed

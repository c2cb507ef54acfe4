"""All fixtures may be written into one folder, and again."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import Fixture, fixtures
from gsgen.contract.validator import validate


def files_of(fixture: Fixture) -> set[str]:
    """Return the names of the files that a fixture writes beside its model."""
    spec = fixture.draw()
    return {*spec.extra_files, *spec.zero_files, *spec.links}


WITH_FILES = [
    fixture for fixture in fixtures() if files_of(fixture) or fixture.draw().external
]  # the second also names fixtures whose file is missing
MISSING_FILES = {"external_data_missing.bin", "reference_image_left_behind.png"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which all fixtures were written twice."""
    folder = tmp_path_factory.mktemp("corpus")
    for _ in range(2):
        for fixture in fixtures():
            fixture.write(folder)
    return folder


def test_files_beside_a_model_have_its_name() -> None:
    for fixture in fixtures():
        assert {Path(name).stem for name in files_of(fixture)} <= {fixture.name}


def test_missing_files_are_missing_where_all_fixtures_are(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert not names & MISSING_FILES
    models = {f"{fixture.name}{fixture.suffix}" for fixture in fixtures()}
    assert names == models.union(*map(files_of, fixtures()))


@pytest.mark.parametrize("fixture", WITH_FILES, ids=lambda fixture: fixture.name)
def test_fixtures_with_files_keep_their_findings_in_that_folder(
    fixture: Fixture, folder: Path
) -> None:
    report = validate(folder / f"{fixture.name}{fixture.suffix}", fixture.settings)
    assert {finding.rule for finding in report.findings} == ({fixture.rule} - {""})

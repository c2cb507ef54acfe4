import pytest
from hypothesis import settings

from gsgen.contract.validation.report import Report
from support.reports.judged import MODELS, judged

# The same examples on every machine and in every run.
settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.load_profile("fixed")


@pytest.fixture(scope="session")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Report]:
    """The reports of three small models, by their names; each is judged once."""
    folder = tmp_path_factory.mktemp("reports")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return {name: judged(name, folder) for name in MODELS}

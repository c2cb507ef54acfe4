"""What rules ask of an inspected model."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.targets import load_target


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> InspectedModel:
    path: Path = find("one_step_enhancer").write(tmp_path_factory.mktemp("inspected"))
    return inspect_model(open_model(path), load_target("core"), Limits())


def test_inputs_are_chosen_by_their_role(subject: InspectedModel) -> None:
    manifest = subject.manifest
    assert manifest is not None
    roles = {entry.role for entry in manifest.inputs}
    assert len(roles) >= 2
    for role in roles:
        pairs = subject.inputs_of(role)
        assert [entry for entry, _ in pairs] == [x for x in manifest.inputs if x.role == role]
        assert all(entry.name == tensor.name for entry, tensor in pairs)
    assert subject.inputs_of("audio") == []

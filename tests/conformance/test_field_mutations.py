"""Each manifest field has a mutation that a rule notices, or a reason why none can."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.field_mutations import (
    FIELD_MUTATIONS,
    UNTESTED_FIELDS,
    FieldMutation,
    manifest_fields,
    mutated_model,
)
from gsgen.contract.validator import validate


def test_every_field_has_a_mutation_or_a_reason() -> None:
    tested = [mutation.field for mutation in FIELD_MUTATIONS]
    assert len(set(tested)) == len(tested)
    assert sorted({*tested, *UNTESTED_FIELDS}) == sorted(manifest_fields())
    assert not set(tested) & set(UNTESTED_FIELDS)
    assert len(tested) > 3 * len(UNTESTED_FIELDS) / 2


@pytest.mark.parametrize("mutation", FIELD_MUTATIONS, ids=lambda mutation: mutation.field)
def test_a_wrong_field_is_noticed(mutation: FieldMutation, tmp_path: Path) -> None:
    base = find(mutation.base)
    assert base.rule == ""
    path = tmp_path / "mutated.onnx"
    mutated_model(mutation, base.draw()).write(path)
    report = validate(path, base.settings)
    assert mutation.rule in {finding.rule for finding in report.findings}
    assert report.verdict != "internal-error"

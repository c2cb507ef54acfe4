import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.contract.spec import upgrades
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest_io import parse
from gsgen.contract.spec.upgrades import UPGRADE_BY_VERSION, upgrade
from support.models.manifests import manifests


@settings(max_examples=100, deadline=None)
@given(manifests(), st.sampled_from(sorted(UPGRADE_BY_VERSION)))
def test_manifest_of_a_development_build_is_read_as_1_0_with_every_field(manifest, version):
    document = json.loads(json.dumps(to_json(manifest)))
    document |= {"contract": f"{version[0]}.{version[1]}", "x-studio": {"take": 7}}
    parsed = parse(json.dumps(document))
    assert parsed.complaints == ()
    assert parsed.manifest.contract == "1.0"
    assert (parsed.manifest, parsed.version, parsed.is_newer_version) == (manifest, version, False)
    assert upgrade(document, version) == document | {"contract": "1.0"}


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        ((1, 0), {"contract": "1.3", "mood": "good!"}),
        ((1, 1), {"contract": "1.3", "mood": "bad!"}),
        ((1, 2), {"contract": "1.2", "mood": "bad"}),
    ],
)
def test_upgrade_of_several_versions_applies_each_step_and_keeps_its_argument(
    version, expected, monkeypatch
):
    steps = {
        (1, 0): lambda document: document | {"contract": "1.1", "mood": "good"},
        (1, 1): lambda document: document | {"contract": "1.3", "mood": document["mood"] + "!"},
    }
    monkeypatch.setattr(upgrades, "UPGRADE_BY_VERSION", steps)
    document = {"contract": f"1.{version[1]}", "mood": "bad"}
    assert upgrade(document, version) == expected
    assert document == {"contract": f"1.{version[1]}", "mood": "bad"}

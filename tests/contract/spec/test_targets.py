import json
from importlib.metadata import EntryPoint

import pytest

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec import targets
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.targets import Target, known_targets, load_target, target_from_json

MINIMAL = {
    "name": "acme",
    "version": "2.0",
    "summary": "A viewer.",
    "opset": [13, 18],
    "ir": 9,
    "domains": ["", "ai.onnx"],
}


def test_our_targets_are_those_of_the_contract():
    assert set(known_targets()) >= {"core", "gsgen", "visionary", "webgpu"}
    for name, target in known_targets().items():
        assert target.name == name
        assert target.label == f"{name}@{target.version}"
        assert target.summary.endswith(".")
        assert target.opset[0] <= 18 <= target.opset[1]


def test_every_severity_and_limit_of_a_target_belongs_to_a_rule():
    rules = installed_rules().rules
    for target in known_targets().values():
        assert set(target.severities) <= set(rules)


def test_the_core_target_adds_nothing_to_the_contract():
    core = load_target("core")
    assert (core.limits, core.severities) == ({}, {})


def test_webgpu_has_the_default_limits_of_the_standard():
    limits = load_target("webgpu").limits
    assert limits["binding_bytes"] == 128 << 20
    assert limits["buffer_bytes"] == 256 << 20
    assert limits["workgroups"] == 65535


def test_a_data_file_is_read():
    more = {"limits": {"rows": 5}, "severities": {"GG016": "error"}}
    target = target_from_json(json.dumps(MINIMAL | more), "acme.json")
    assert target == Target(
        name="acme",
        version="2.0",
        summary="A viewer.",
        opset=(13, 18),
        ir=9,
        domains=frozenset({"", "ai.onnx"}),
        limits={"rows": 5},
        severities={"GG016": Severity.ERROR},
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "3",
        json.dumps({key: value for key, value in MINIMAL.items() if key != "ir"}),
        json.dumps(MINIMAL | {"opset": [13]}),
        json.dumps(MINIMAL | {"opset": 13}),
        json.dumps(MINIMAL | {"severities": ["GG016"]}),
        json.dumps(MINIMAL | {"severities": {"GG016": 3}}),
        json.dumps(MINIMAL | {"severities": {"GG016": "fatal"}}),
    ],
)
def test_a_data_file_of_another_form_is_refused(text):
    with pytest.raises(ConfigInvalid):
        target_from_json(text, "acme.json")


def test_a_target_is_loaded_by_name_with_or_without_version():
    assert load_target("visionary") is load_target("visionary@1.0.1")


def test_another_version_is_an_error():
    with pytest.raises(ConfigInvalid) as caught:
        load_target("visionary@2", "gsgen.toml")
    assert str(caught.value) == "gsgen.toml: validation target visionary has version 1.0.1, not 2"


def test_an_unknown_target_names_the_nearest():
    with pytest.raises(UnknownName) as caught:
        load_target("visonary")
    assert str(caught.value) == ("--target: unknown target 'visonary'\n  Did you mean 'visionary'?")


ACME = target_from_json(json.dumps(MINIMAL), "acme.json")


def make_acme():
    return ACME


def make_nothing():
    return None


@pytest.fixture
def registered(monkeypatch):
    """Register an object of this module as a third party's target."""

    def register(name):
        point = EntryPoint("acme", f"{__name__}:{name}", "gsgen.targets")
        monkeypatch.setattr(EntryPoint, "load", lambda self: globals()[name])
        monkeypatch.setattr(targets, "registered_entry_points", lambda group: [point])

    known_targets.cache_clear()
    yield register
    known_targets.cache_clear()


@pytest.mark.parametrize("name", ["ACME", "make_acme"])
def test_a_third_party_can_add_a_target(registered, name):
    registered(name)
    assert load_target("acme@2.0") is ACME


@pytest.mark.parametrize(
    ("name", "expected_message"),
    [
        ("absent", "the target runtime's definition cannot be loaded: KeyError('absent')"),
        ("make_nothing", "the entry point returns None, expected a Target"),
    ],
)
def test_a_third_partys_target_that_does_not_load_is_named(registered, name, expected_message):
    registered(name)
    with pytest.raises(ConfigInvalid) as caught:
        known_targets()
    assert str(caught.value) == f"target acme = {__name__}:{name}: {expected_message}"


def test_our_own_targets_load_whatever_a_third_partys_does(registered):
    registered("absent")
    assert load_target("core").name == "core"

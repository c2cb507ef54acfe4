"""Which suites a model has, by what its manifest declares."""

from collections import Counter
from pathlib import Path

import pytest

from conformance.pytest_runs import write
from gsgen.conformance.run import suites_of
from gsgen.conformance.suite import ALL_SUITES, BASIC, find_suite
from gsgen.contract.errors import UnknownName
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.fields.roles import GENERATOR, TRAJECTORY
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings


@pytest.mark.parametrize(
    ("name", "suites"),
    [
        ("still_sh0", "basic appearance capture"),
        ("drift", "basic time appearance capture"),
        ("frame_table", "basic time appearance capture"),
        ("camera_and_proj", "basic camera appearance capture"),
        ("viewport", "basic camera appearance capture"),
        ("avatar", "basic avatar appearance capture"),
        ("body_shape", "basic avatar appearance capture"),
        ("post_process", "basic post-process capture"),
        ("trajectory", "basic trajectory"),
        ("manifest_is_no_json", "basic"),
    ],
)
def test_suites_follow_the_manifest(tmp_path: Path, name: str, suites: str) -> None:
    (model,) = write(tmp_path, name)
    assert list(suites_of(model, Settings())) == suites.split()


@pytest.mark.parametrize("target", ["core", "webgpu", "visionary"])
@pytest.mark.parametrize("name", ["drift", "trajectory", "manifest_is_no_json"])
def test_every_rule_that_can_fail_is_in_one_suite(tmp_path: Path, name: str, target: str) -> None:
    (model,) = write(tmp_path, name)
    kind = {"drift": GENERATOR, "trajectory": TRAJECTORY}.get(name)  # else nobody knows
    settings = Settings(target=load_target(target))
    planned = suites_of(model, settings)
    counted = Counter(rule.id for rules in planned.values() for rule in rules)
    assert set(counted.values()) == {1}
    for rule in installed_rules().rules.values():
        is_foreign = rule.target not in ("", target)
        other_kind = kind is not None and kind not in rule.kinds
        lacks_limit = bool(rule.limit) and rule.limit not in settings.target.limits
        assert (rule.id in counted) is not (is_foreign or other_kind or lacks_limit), rule.id


def test_a_rule_of_a_suite_that_does_not_apply_is_basic(tmp_path: Path) -> None:
    (still,) = write(tmp_path, "still_sh0")
    planned = suites_of(still, Settings())
    assert "GI001" in [rule.id for rule in planned["basic"]]


def test_suites_have_different_names_and_summaries() -> None:
    names = [suite.name for suite in ALL_SUITES]
    assert len(set(names)) == len(names) == len({suite.summary for suite in ALL_SUITES})
    assert ALL_SUITES[-1] is BASIC  # it claims all that is left
    with pytest.raises(UnknownName, match="Did you mean 'avatar'"):
        find_suite("avatars")

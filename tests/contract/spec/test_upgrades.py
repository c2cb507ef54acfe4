import pytest

from gsgen.contract.spec.upgrades import CURRENT, UPGRADES, upgrade, upgrade_1_0_to_1_1


def lift(document):
    return document | {"contract": "1.1", "mood": "good"}


def lift_further(document):
    return document | {"contract": "1.3", "mood": document["mood"] + "!"}


STEPS = {(1, 0): lift, (1, 1): lift_further}


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        ((1, 0), {"contract": "1.3", "mood": "good!"}),
        ((1, 1), {"contract": "1.3", "mood": "bad!"}),
        ((1, 2), {"contract": "1.2", "mood": "bad"}),
        ((1, 3), {"contract": "1.3", "mood": "bad"}),
    ],
)
def test_a_document_is_lifted_as_far_as_the_steps_reach(version, expected):
    document = {"contract": f"1.{version[1]}", "mood": "bad"}
    assert upgrade(document, version, STEPS) == expected


def test_the_document_given_is_left_as_it_is():
    def rewrite(document):
        document["contract"] = "1.1"
        return document

    document = {"contract": "1.0"}
    assert upgrade(document, (1, 0), {(1, 0): rewrite}) == {"contract": "1.1"}
    assert document == {"contract": "1.0"}


@pytest.mark.parametrize("reached", ["1.0", "0.9"])
def test_a_step_that_does_not_lead_onwards_is_a_fault(reached):
    steps = {(1, 0): lambda document: document | {"contract": reached}}
    with pytest.raises(ValueError, match=r"^the manifest upgrade from \(1, 0\) led to"):
        upgrade({"contract": "1.0"}, (1, 0), steps)


def test_every_published_step_starts_before_the_current_version():
    assert all(version < CURRENT for version in UPGRADES)


FIRST = {
    "contract": "1.0",
    "kind": "gaussian-generator",
    "name": "old",
    "outputs": {},
    "x-studio": {"blend": "wsr"},
}


def test_the_first_version_is_lifted_and_nothing_else_of_it_changes():
    document = FIRST | {"blend": "alpha"}
    assert upgrade_1_0_to_1_1(document) == document | {"contract": "1.1"}
    assert document["contract"] == "1.0"


def test_a_weighted_sum_without_cells_is_blended_as_its_readers_had_to():
    document = FIRST | {"blend": "wsr"}
    expected = document | {"contract": "1.1", "blend": "alpha"}
    assert upgrade_1_0_to_1_1(document) == expected

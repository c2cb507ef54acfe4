import json

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.config import Settings
from gsgen.contract.engine import validate
from gsgen.contract.finding import Level
from support.small_models import good_rows, manifest_of, moving, save

STATIC = Settings(level=Level.STATIC)


def tolerances(path):
    found = validate(path, STATIC).tolerances
    return {one.field: (one.value, one.source) for one in found}


@pytest.fixture
def declaring(tmp_path):
    """Save a model whose manifest declares some tolerances."""

    def saved(declared):
        path = save(tmp_path / "a.onnx", moving(good_rows(4)), manifest_of(4))
        import onnx

        proto = onnx.load(path)
        document = json.loads(proto.metadata_props[0].value) | declared
        proto.metadata_props[0].value = json.dumps(document)
        onnx.save(proto, path)
        return path

    return saved


def test_what_the_manifest_does_not_say_is_the_default(declaring):
    assert tolerances(declaring({})) == {
        "position": (1e-3, "default"),
        "covariance": (1e-3, "default"),
        "opacity": (2e-3, "default"),
        "appearance": (2e-3, "default"),
    }


def test_what_the_manifest_says_holds_even_where_it_says_the_default(declaring):
    found = tolerances(declaring({"tolerances": {"opacity": 0.1, "position": 1e-3}}))
    assert found["opacity"] == (0.1, "manifest")
    assert found["position"] == (1e-3, "manifest")
    assert found["covariance"] == (1e-3, "default")


def test_units_come_from_the_manifest_s_own_declaration(declaring):
    units = {one.field: one.unit for one in validate(declaring({}), STATIC).tolerances}
    assert units["position"] == "in standard deviations of the Gaussian"
    assert units["opacity"] == "absolute"


def test_a_guessed_manifest_has_the_defaults(tmp_path):
    path = save(tmp_path / "a.onnx", moving(good_rows(4)))
    assert {source for _, source in tolerances(path).values()} == {"default"}


def test_what_is_no_generator_has_none(tmp_path):
    report = validate(find("post_process").write(tmp_path), STATIC)
    assert report.kind == "post-process"
    assert report.tolerances == ()

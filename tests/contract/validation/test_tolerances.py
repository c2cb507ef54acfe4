import json
from dataclasses import replace

import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings, read_config
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, manifest_of, moving, save

STATIC = Settings(level=Level.STATIC)


def tolerances(path):
    tolerances_found = validate(path, STATIC).tolerances
    return {tolerance.field: (tolerance.value, tolerance.source) for tolerance in tolerances_found}


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


def test_undeclared_tolerance_has_the_default(declaring):
    assert tolerances(declaring({})) == {
        "position": (1e-3, "default"),
        "covariance": (1e-3, "default"),
        "opacity": (2e-3, "default"),
        "appearance": (2e-3, "default"),
    }


def test_declared_tolerance_is_used_even_if_it_is_the_default(declaring):
    tolerances_found = tolerances(declaring({"tolerances": {"opacity": 0.1, "position": 1e-3}}))
    assert tolerances_found["opacity"] == (0.1, "manifest")
    assert tolerances_found["position"] == (1e-3, "manifest")
    assert tolerances_found["covariance"] == (1e-3, "default")


def test_units_come_from_the_manifest_s_own_declaration(declaring):
    units = {
        tolerance.field: tolerance.unit for tolerance in validate(declaring({}), STATIC).tolerances
    }
    assert units["position"] == "in standard deviations of the Gaussian"
    assert units["opacity"] == "absolute"


def test_a_guessed_manifest_has_the_defaults(tmp_path):
    path = save(tmp_path / "a.onnx", moving(good_rows(4)))
    assert {source for _, source in tolerances(path).values()} == {"default"}


def test_other_kinds_of_model_have_no_tolerances(tmp_path):
    report = validate(find("post_process").write(tmp_path), STATIC)
    assert report.kind == "post-process"
    assert report.tolerances == ()


def test_the_configuration_wins_over_the_manifest(declaring, tmp_path):
    path = declaring({"tolerances": {"opacity": 0.1, "position": 0.2}})
    file = tmp_path / "gsgen.toml"
    file.write_text("[tolerances]\nopacity = 0.5\n")
    settings = replace(read_config(file, installed_rules()), level=Level.STATIC)
    tolerances_found = {
        tolerance.field: (tolerance.value, tolerance.source)
        for tolerance in validate(path, settings).tolerances
    }
    assert tolerances_found["opacity"] == (0.5, "config")
    assert tolerances_found["position"] == (0.2, "manifest")
    assert tolerances_found["covariance"] == (1e-3, "default")


@pytest.mark.parametrize(
    ("text", "message"),
    [("opacty = 1", "Did you mean 'opacity'"), ("opacity = -1", "less than the minimum")],
)
def test_invalid_tolerance_is_refused(tmp_path, text, message):
    file = tmp_path / "gsgen.toml"
    file.write_text(f"[tolerances]\n{text}\n")
    with pytest.raises(ConfigInvalid, match=message):
        read_config(file, installed_rules())


def told_of_the_optimiser(path, **settings):
    report = validate(path, Settings(**settings))
    assert report.outcome("GB010").status in ("pass", "fail")
    return [
        f"{tolerance.where}: {tolerance.message}"
        for tolerance in report.findings
        if tolerance.rule == "GB010"
    ]


def test_comparing_rules_use_the_tolerances(tmp_path):
    spec = find("optimised_wrongly").draw()
    spec.write(tmp_path / "m.onnx")
    (message,) = told_of_the_optimiser(tmp_path / "m.onnx")
    assert message.startswith("output gaussians, position: row ")
    unit = "in standard deviations of the Gaussian"
    assert f"expected 0.001 at most, {unit} (the contract's own)" in message
    (message,) = told_of_the_optimiser(tmp_path / "m.onnx", tolerances={"position": 0.5})
    assert f"expected 0.5 at most, {unit} (by the configuration)" in message
    assert not told_of_the_optimiser(tmp_path / "m.onnx", tolerances={"position": 1e3})
    spec.with_manifest(tolerances=Tolerances(position=0.25)).write(tmp_path / "m.onnx")
    (message,) = told_of_the_optimiser(tmp_path / "m.onnx")
    assert "expected 0.25 at most" in message
    assert "(by the manifest)" in message

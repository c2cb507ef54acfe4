"""Upper bounds of operator set and IR version that follow the installed ONNX Runtime."""

from dataclasses import replace
from pathlib import Path

import onnxruntime
import pytest
from onnx import ModelProto

from gsgen.conformance.fixtures.builders.scenes import still
from gsgen.contract.model.inspected_model import raised_to_installed
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

OLD_TARGET = replace(load_target("core"), opset=(13, 13), ir=8)


def high_model(opset: int, ir_version: int) -> ModelProto:
    model = ModelProto(ir_version=ir_version)
    model.opset_import.add(domain="", version=opset)
    return model


def test_the_bounds_are_those_that_onnx_runtime_loads() -> None:
    raised = raised_to_installed(OLD_TARGET, high_model(99, 99))
    model = still().build()
    model.opset_import[0].version, model.ir_version = raised.opset[1], raised.ir
    onnxruntime.InferenceSession(model.SerializeToString())
    model.ir_version += 1
    with pytest.raises(Exception, match="IR version"):
        onnxruntime.InferenceSession(model.SerializeToString())


def test_a_newer_operator_set_than_the_data_file_names_is_supported(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(still().build().SerializeToString())  # operator set 18
    settings = Settings(target=OLD_TARGET, level=Level.STATIC)
    assert validate(path, settings).outcome("GG001").status == "pass"
    followed_settings = replace(settings, target=replace(OLD_TARGET, follows_runtime=False))
    assert validate(path, followed_settings).outcome("GG001").status == "fail"


def test_bounds_that_suffice_and_those_of_other_targets_stay() -> None:
    core, visionary = load_target("core"), load_target("visionary")
    assert raised_to_installed(core, high_model(18, 8)) is core
    assert raised_to_installed(visionary, high_model(99, 99)) is visionary

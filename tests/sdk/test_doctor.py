"""The SDK's part of `gsgen doctor`: each package, with the command that installs it."""

import pytest

from gsgen.contract.tools.doctor import Check
from gsgen.contract.validation.level_backend import LevelUnavailable
from gsgen.sdk import doctor
from gsgen.sdk.live import level


def test_doctor_lists_every_package_of_the_extras(monkeypatch: pytest.MonkeyPatch) -> None:
    def package(name: str, remedy: str, *, purpose: str) -> Check:
        return Check(name=name, state="missing", detail="", remedy=remedy, purpose=purpose)

    def survey() -> None:
        raise LevelUnavailable("no adapter", hint="Install a driver.")

    monkeypatch.setattr(doctor, "check_package", package)
    monkeypatch.setattr(level, "survey", survey)
    checks = {check.name: (check.remedy, check.purpose) for check in doctor.checks()}
    export = ("pip install 'gsgen[sdk]'", "export from torch")
    assert checks == {
        "torch": export,
        "onnxscript": export,
        "onnx-ir": export,
        "scipy": (export[0], "sizes of bare point clouds"),
        "onnxruntime-ep-webgpu": ("pip install 'gsgen[live]'", "level live"),
        "webgpu": ("Install a driver.", "level live"),
    }

"""What `gsgen doctor` says of windows and notebooks."""

import pytest

from gsgen.contract.tools.doctor import Check
from gsgen.runtime import doctor


def installed(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    def package(name: str, remedy: str, *, purpose: str = "") -> Check:
        if name in names:
            return Check(name=name, state="ok", detail="1.0", remedy="", purpose=purpose)
        return Check(
            name=name, state="missing", detail="not installed", remedy=remedy, purpose=purpose
        )

    monkeypatch.setattr(doctor, "check_package", package)


def fake_screen_error(monkeypatch: pytest.MonkeyPatch, expected_message: object) -> None:
    monkeypatch.setattr(doctor, "_child_result", lambda *_: expected_message)


def check_named(name: str) -> Check:
    (check,) = (check for check in doctor.checks() if check.name == name)
    return check


def test_doctor_reports_the_kernels_and_the_reason() -> None:
    check = check_named("renderer")
    assert check.state == "ok"
    assert "kernels for CPUs, which is where the driver runs; tiles of 16 pixels" in check.detail
    assert "rasteriser tiles: software drivers always use them" in check.detail


def test_missing_screen_check_suggests_render(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    check = check_named("screen")
    assert check.state == "missing"
    assert "no window can be opened" in check.detail
    assert "gsgen render" in check.remedy


def test_available_screen_is_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_screen_error(monkeypatch, None)
    installed(monkeypatch, "glfw", "rendercanvas")
    assert check_named("screen").state == "ok"


@pytest.mark.parametrize("installed_packages", [(), ("glfw",), ("rendercanvas",)])
def test_windows_need_two_packages(
    monkeypatch: pytest.MonkeyPatch, installed_packages: tuple[str, ...]
) -> None:
    installed(monkeypatch, *installed_packages)
    for name in ("glfw", "rendercanvas"):
        check = check_named(name)
        assert check.state == ("ok" if name in installed_packages else "missing")
        assert check.state == "ok" or check.remedy == "pip install 'gsgen[runtime]'"
    assert not [check for check in doctor.checks() if check.name == "screen"]


@pytest.mark.parametrize("package_name", ["anywidget", "jupyter_rfb"])
def test_one_widget_is_enough(monkeypatch: pytest.MonkeyPatch, package_name: str) -> None:
    installed(monkeypatch, package_name)
    assert check_named(package_name).state == "ok"


def test_no_widget_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch)
    check = check_named("anywidget")
    assert (check.state, check.remedy) == ("missing", "pip install anywidget")
    assert "notebooks" in check.purpose


def test_every_adapter_has_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    adapters = [
        {"device": "llvmpipe", "adapter_type": "CPU", "backend_type": "Vulkan"},
        {"device": "Arc", "adapter_type": "IntegratedGPU", "description": "driver 25"},
    ]
    fake_screen_error(monkeypatch, adapters)
    installed(monkeypatch, "wgpu")
    details = [check.detail for check in doctor.checks() if check.name == "adapter"]
    assert details == ["llvmpipe (CPU, Vulkan)", "Arc (IntegratedGPU, ?) driver 25"]

"""Software Vulkan drivers, each tried in a process of its own: a process has one for good."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]

DRIVERS = {
    "llvmpipe": [Path("/usr/share/vulkan/icd.d/lvp_icd.json"),
                 *sorted(Path("/usr/share/vulkan/icd.d").glob("lvp_icd.*.json"))],
    "SwiftShader": [ROOT / ".venv/swiftshader/vk_swiftshader_icd.json",
                    Path("/usr/lib/chromium/vk_swiftshader_icd.json"),
                    Path("/usr/lib/chromium-browser/vk_swiftshader_icd.json")],
}  # fmt: skip
"""By a word of the adapter's name: where the loader's description of it may be."""


def description(driver: str) -> Path | None:
    """Return the loader's description of a driver, or None if it is not here."""
    return next((path for path in DRIVERS[driver] if path.is_file()), None)


def environment(driver_info: Path) -> dict[str, str]:
    """Return the surroundings of a process that has the driver that ``found`` describes."""
    return os.environ | {
        "VK_DRIVER_FILES": str(driver_info),
        "VK_ICD_FILENAMES": str(driver_info),
        "PYTHONPATH": str(ROOT / "tests"),
    }


def on_driver(driver: str, module: str, *words: str, seconds: float = 600) -> Any:
    """Run ``python -m module`` on a driver, and return the JSON that it prints last."""
    driver_info = description(driver)
    if driver_info is None:
        pytest.fail(f"{driver} is not installed; `make drivers` installs it")
    completed = subprocess.run(
        [sys.executable, "-P", "-m", module, *words],
        capture_output=True,
        text=True,
        timeout=seconds,
        env=environment(driver_info),
    )
    assert completed.returncode == 0, completed.stderr[-4000:]
    return json.loads(completed.stdout.strip().splitlines()[-1])

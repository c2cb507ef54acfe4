"""The contract's part of `gsgen doctor`: which distribution brings ONNX Runtime."""

from pathlib import Path

import pytest

from gsgen.contract.tools import doctor


@pytest.mark.parametrize(
    ("installed", "name", "state", "remedy"),
    [
        ([], "onnxruntime", "missing", "pip install onnxruntime"),
        (["onnxruntime"], "onnxruntime", "ok", ""),
        (["onnxruntime-gpu"], "onnxruntime-gpu", "ok", ""),
        (
            ["onnxruntime", "onnxruntime-gpu"],
            "onnxruntime",
            "broken",
            "pip uninstall -y onnxruntime onnxruntime-gpu && pip install onnxruntime-gpu",
        ),
    ],
)
def test_flavours_of_onnxruntime(
    installed: list[str],
    name: str,
    state: str,
    remedy: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for distribution in installed:
        info = tmp_path / f"{distribution.replace('-', '_')}-1.31.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.31.0\n", "utf-8"
        )
        (info / "top_level.txt").write_text("onnxruntime\n", "utf-8")
    monkeypatch.setattr("sys.path", [str(tmp_path)])
    check = doctor._check_onnxruntime()
    assert (check.name, check.state, check.remedy) == (name, state, remedy)
    assert all(distribution in check.detail or state != "broken" for distribution in installed)

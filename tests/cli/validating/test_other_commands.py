import json
from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.tiles.validation.rules import all_rules
from support.commands import ROOT, gsgen, gsgen_here


def test_help_lists_every_command() -> None:
    completed = gsgen("--help")
    assert completed.code == 0
    for name in ("validate", "inspect", "explain", "rules", "doctor", "export"):
        assert name in completed.out


def test_version_is_the_distribution_s() -> None:
    completed = gsgen("--version")
    assert completed.code == 0
    assert completed.out.startswith("gsgen 0.")


def test_explain_takes_ids_and_names_in_any_case() -> None:
    by_id, by_name = gsgen_here("explain", "gv003"), gsgen_here("explain", "opacity-range")
    assert by_id.out == by_name.out
    assert "## Why" in by_id.out
    assert "## How to repair it" in by_id.out
    wrong = gsgen_here("explain", "GV03")
    assert wrong.code == 2
    assert "Did you mean 'GV003'?" in wrong.err


def test_rules_as_json_is_the_catalogue() -> None:
    listed = json.loads(gsgen_here("rules", "--json").out)
    assert [entry["id"] for entry in listed] == list(all_rules().rules)


def told(page: Path) -> tuple[str, dict[str, str]]:
    """Return title and promise of a rule's page, and the sections in the rule's own words."""
    head, *parts = page.read_text().split("\n---\n")[0].split("\n## ")
    sections = dict(part.split("\n", 1) for part in parts)
    return "\n".join(head.splitlines()[:3]), {
        name: sections[name].strip() for name in ("Why", "How to repair it") if name in sections
    }


def test_published_rule_pages_are_current(tmp_path: Path) -> None:
    assert gsgen_here("rules", "--pages", tmp_path).code == 0
    fresh = {path.name: told(path) for path in tmp_path.glob("[GT]*.md")}
    # The documentation adds facts, examples, thresholds and links.
    retained = {path.name: told(path) for path in (ROOT / "docs/rules").glob("[GT]*.md")}
    assert len(fresh) > 200
    assert fresh["GM002.md"][1].keys() == {"Why", "How to repair it"}
    assert fresh == retained, "run: scripts/write_docs.py"


def test_inspect_prints_the_manifest_and_interface(good: Path) -> None:
    completed = gsgen_here("inspect", good)
    assert completed.code == 0
    assert "output  gaussians: float32 [40, 10]" in completed.out
    facts = json.loads(gsgen_here("inspect", good, "--json").out)
    assert facts["manifest"]["outputs"]["gaussians"]["capacity"] == 40


def test_inspect_derives_a_manifest_that_validates(good: Path, tmp_path: Path) -> None:
    import onnx

    from gsgen.contract.model.model_file import write_manifest
    from gsgen.contract.spec.manifest_io import loads

    model = onnx.load(good)
    del model.metadata_props[:]
    onnx.save(model, good)
    completed = gsgen_here("inspect", good, "--emit-manifest")
    assert completed.code == 0
    assert "Confirm:" in completed.err
    write_manifest(good, loads(completed.out), tmp_path / "with.onnx")
    assert gsgen_here("validate", tmp_path / "with.onnx").code == 0


def test_inspect_prints_the_schema_of_a_kind() -> None:
    schema = json.loads(gsgen_here("inspect", "--schema", "gaussian-generator").out)
    assert schema["$schema"].endswith("2020-12/schema")
    assert "Did you mean" in gsgen_here("inspect", "--schema", "gaussian-generater").err


def test_inspect_of_no_model_exits_4(tmp_path: Path) -> None:
    assert gsgen_here("inspect", tmp_path).code == 4


def test_doctor_finds_the_software_driver_that_tests_need() -> None:
    """A missing driver fails here, and is not skipped: `make drivers` installs it."""
    completed = gsgen_here("doctor", "--json")
    rooms = json.loads(completed.out)
    adapters = [c for c in rooms["runtime"] if c["name"] == "adapter" and c["state"] == "ok"]
    vulkan = [c["detail"] for c in adapters if "Vulkan" in c["detail"]]
    assert vulkan, f"no Vulkan adapter: {rooms['runtime']}"
    assert completed.code == 0


def test_doctor_names_the_command_that_repairs(tmp_path: Path) -> None:
    completed = gsgen_here(
        "doctor", env={"VK_DRIVER_FILES": str(tmp_path / "none.json"), "WGPU_BACKEND": "Vulkan"}
    )
    assert "contract" in completed.out
    assert "sandbox" in completed.out


@pytest.mark.parametrize("dtype", ["float32", "float16"])
def test_export_static_passes_packed_rows_through(tmp_path: Path, dtype: str) -> None:
    import onnxruntime

    rng = np.random.default_rng(1)
    packed = np.zeros((9, 10), dtype)
    packed[:, :3] = rng.normal(size=(9, 3))
    packed[:, 3] = 0.5
    packed[:, [4, 7, 9]] = 0.01
    color = rng.normal(size=(9, 48)).astype(dtype) * np.asarray(0.1, dtype)
    np.savez(tmp_path / "rows.npz", gaussians=packed, appearance=color)
    completed = gsgen_here("export", "static", tmp_path / "rows.npz", "-o", tmp_path / "m.onnx")
    assert completed.code == 0, completed.err
    session = onnxruntime.InferenceSession(tmp_path / "m.onnx")
    gaussians, appearance, count = session.run(["gaussians", "color_sh", "num_points"], {})
    assert gaussians.dtype == packed.dtype
    np.testing.assert_array_equal(gaussians, packed)
    np.testing.assert_array_equal(appearance, color)
    assert count.tolist() == [9]


def test_export_static_says_when_packed_rows_do_not_conform(tmp_path: Path) -> None:
    packed = np.full((4, 10), np.nan, np.float32)
    np.savez(tmp_path / "rows.npz", gaussians=packed, appearance=np.zeros((4, 3), np.float32))
    completed = gsgen_here("export", "static", tmp_path / "rows.npz", "-o", tmp_path / "m.onnx")
    assert "does NOT conform" in completed.out
    assert "GV001" in completed.out
    assert gsgen_here("validate", tmp_path / "m.onnx").code == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read: No such file"),
        (b"", "empty"),
        (b"hello", "this is text that begins 'hello'"),
        (b"ply\nformat binary_little_endian 1.0\nelement vertex 5\nend_header\n", "x"),
    ],
)
def test_export_static_of_a_bad_file_exits_4_and_writes_nothing(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    path = tmp_path / "in.ply"
    if content is not None:
        path.write_bytes(content)
    completed = gsgen_here("export", "static", path, "-o", tmp_path / "m.onnx")
    assert completed.code == 4
    assert words in completed.err
    assert "Traceback" not in completed.err
    assert {entry.name for entry in tmp_path.iterdir()} <= {"in.ply"}


def test_export_static_takes_the_options_of_every_export(tmp_path: Path) -> None:
    rows = np.zeros((4, 10), np.float32)
    rows[:, 3], rows[:, [4, 7, 9]] = 0.5, 0.01
    np.savez(tmp_path / "rows.npz", gaussians=rows, appearance=np.zeros((4, 48), "f4"))
    words = ("--opset", "17", "--target", "visionary", "--no-rewrite", "--capacity", "256")
    completed = gsgen(
        *("export", "static", "rows.npz", "-o", "m.onnx", "--report", "r.json", *words),
        cwd=tmp_path,
    )
    assert completed.code == 0, completed.err
    document = json.loads((tmp_path / "r.json").read_text())
    assert (document["schema"], document["source"]) == ("gsgen-export/1", "static")
    assert (document["written"], document["options"]["opset"]) == (True, 17)
    assert document["validation"]["target"].startswith("visionary")
    assert onnx.load(tmp_path / "m.onnx").opset_import[0].version == 17

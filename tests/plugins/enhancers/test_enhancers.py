"""Enhancers against their methods' own code, and against plain formulas in float64."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.enhancers.enhancer import Enhancer
from gsgen.reference_plugins.enhancers.enhancer_checkpoint import read_network
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, NotInCheckpoint
from gsgen.reference_plugins.synthetic import write_enhancer
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from plugins.enhancers.cases import CASES, GOLDENS
from plugins.enhancers.enhancer_oracle import restored
from support.checkpoints.image_goldens import ALLOWED, MARGIN, assert_image_golden
from support.models.captured import assert_captured

each_case = pytest.mark.parametrize("name", CASES)
# In half precision, one network of each architecture before each change; all of them at night.
HALF_CASES = ("rrdb_x4", "compact_x4", "swinir_classical", "swinir_real", "nafnet")
EXPORTS = [
    pytest.param(
        name, dtype, marks=[] if dtype == "float32" or name in HALF_CASES else [pytest.mark.nightly]
    )
    for name in CASES
    for dtype in ("float32", "float16")
]


@each_case
def test_the_method_s_own_code_gives_the_same_image(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    network, image = read_network(case.write(tmp_path)).eval(), torch.from_numpy(case.image())
    # The code of RRDBNet and SRVGGNetCompact takes multiples alone, that of the others fills up.
    padding = [-side % network.multiple for side in case.size]
    padded = torch.nn.functional.pad(image, (0, padding[1], 0, padding[0]), mode=network.padding)
    with torch.no_grad():
        result = network(padded).numpy()
    height, width = (network.scale * side for side in case.size)
    assert_image_golden(GOLDENS / f"{name}.npz", result[:, :, :height, :width])


@each_case
def test_plain_formulas_in_float64_give_the_same_image(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    file = case.write(tmp_path)
    with torch.no_grad():
        enhancer = Enhancer(read_network(file), case.size).eval()
        result = enhancer(torch.from_numpy(case.image())).numpy()
    expected = restored(case.method, file, case.image()[0])
    assert np.abs(result[0] - np.clip(expected, 0, 1)).max() <= ALLOWED


@pytest.mark.slow
@pytest.mark.parametrize(("name", "dtype"), EXPORTS)
def test_the_model_agrees_with_the_method_three_times_better_than_asked(
    name: str, dtype: str, tmp_path: Path
) -> None:
    case = CASES[name]
    enhancer = Enhancer(read_network(case.write(tmp_path)), case.size)
    path = tmp_path / "model.onnx"
    settings = Settings(level=Level.STATIC)
    export_post_process(enhancer, path, dtype=dtype, target="webgpu", settings=settings)
    session = onnxruntime.InferenceSession(path)
    (result,) = session.run(None, {"image": case.image().astype(dtype)})
    allowed = enhancer.half_tolerance if dtype == "float16" else enhancer.tolerance
    assert_image_golden(GOLDENS / f"{name}.npz", result, allowed / MARGIN, limits=(0, 1))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rrdb_x2", "compact_x4", "swinir_real", "nafnet"])
def test_models_are_captured_and_replayed_in_webgpu(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    enhancer = Enhancer(read_network(case.write(tmp_path)), (16, 24))
    settings = Settings(level=Level.LIVE)
    exported = export_post_process(
        enhancer, tmp_path / "model.onnx", target="webgpu", settings=settings
    )
    assert_captured(exported.report)


@pytest.mark.parametrize(
    "name",
    [
        *("rrdb_x2", "compact_x2", "nafnet"),
        pytest.param("swinir_classical", marks=pytest.mark.slow),
    ],
)
def test_a_model_of_open_size_takes_odd_sizes(name: str, tmp_path: Path) -> None:
    enhancer = Enhancer(read_network(CASES[name].write(tmp_path)), None)
    path = tmp_path / "open.onnx"
    settings = Settings(level=Level.VALUES)
    exported = export_post_process(enhancer, path, settings=settings)  # rule GV056 sees 37 × 53
    assert exported.manifest.outputs.image.scale == enhancer.scale
    session = onnxruntime.InferenceSession(path)
    for size in ((19, 24), (33, 27)):
        image = np.random.default_rng(0).random((1, 3, *size)).astype(np.float32)
        (result,) = session.run(None, {"image": image})
        with torch.no_grad():
            expected = Enhancer(enhancer.network, size)(torch.from_numpy(image)).numpy()
        assert np.abs(result - expected).max() <= ALLOWED


@pytest.mark.parametrize("scale", [2, 3, 4])
def test_weights_by_formula_enlarge_by_a_cubic(scale: int, tmp_path: Path) -> None:
    options = {"scale": scale, "layers": 0, "cubic": True}
    network = read_network(write_enhancer(tmp_path / "cubic.pth", "compact", **options))
    rows, columns = np.mgrid[0:11, 0:9] / 10.0
    plane = np.stack([rows, columns, 0.5 * rows * columns])  # cubics keep polynomials as they are
    with torch.no_grad():
        result = network(torch.from_numpy(plane[None]).float())[0].numpy()
    y, x = np.mgrid[0 : 11 * scale, 0 : 9 * scale]
    y, x = (((place + 0.5) / scale - 0.5) / 10 for place in (y, x))
    inner = np.s_[:, 2 * scale : -2 * scale, 2 * scale : -2 * scale]
    np.testing.assert_allclose(result[inner], np.stack([y, x, 0.5 * y * x])[inner], atol=1e-6)


def test_weights_are_found_below_every_wrapper(tmp_path: Path) -> None:
    states = []
    for wrapper in ("params_ema", "params", "state_dict", ""):
        file = write_enhancer(tmp_path / f"weights-{wrapper}.pth", "compact", wrapper=wrapper)
        states.append(read_network(file).state_dict())
    for state in states[1:]:
        assert all(torch.equal(value, states[0][name]) for name, value in state.items())


def test_averaged_weights_are_preferred(tmp_path: Path) -> None:
    first = torch.load(write_enhancer(tmp_path / "a.pth", seed=1))["params_ema"]
    second = torch.load(write_enhancer(tmp_path / "b.pth", seed=2))["params_ema"]
    torch.save({"params": second, "params_ema": first}, tmp_path / "both.pth")
    network = read_network(tmp_path / "both.pth")
    assert torch.equal(network.state_dict()["body.0.weight"], first["body.0.weight"])


def changed(file: Path, **changes: torch.Tensor | None) -> Path:
    content = torch.load(file)
    for name, value in changes.items():
        key = name.replace("__", ".")
        content["params_ema"].pop(key, None)
        if value is not None:
            content["params_ema"][key] = value
    torch.save(content, file)
    return file


@pytest.mark.parametrize(
    ("method", "changes", "message"),
    [
        ("rrdb", {"conv_first__weight": torch.zeros(8, 4, 3, 3)}, "takes 4 channels, expected one"),
        ("rrdb", {"conv_hr__bias": None}, "missing: conv_hr.bias"),
        ("compact", {"body__1__weight": None}, "rectifiers without weights are relu or leakyrelu"),
        (
            "compact",
            {"body__6__weight": torch.zeros(10, 12, 3, 3)},
            "expected three times a square",
        ),
        (
            "swinir",
            {"conv_first__weight": torch.zeros(12, 1, 3, 3)},
            "takes 1 channels, expected 3",
        ),
        ("swinir", {"absolute_pos_embed": torch.zeros(1, 9, 12)}, "which fixes the size of images"),
        ("nafnet", {"decoders__1__0__beta": None}, "missing: decoders.1.0.beta"),
        ("nafnet", {"intro__weight": torch.full((8, 3, 3, 3), torch.nan)}, "holds NaN or infinity"),
    ],
)
def test_networks_that_do_not_fit_are_refused(
    method: str, changes: dict, message: str, tmp_path: Path
) -> None:
    file = changed(write_enhancer(tmp_path / "network.pth", method), **changes)
    with pytest.raises(CheckpointInvalid, match=message):
        read_network(file)


def test_unknown_files_are_told_the_known_layouts(tmp_path: Path) -> None:
    torch.save({"conv.weight": torch.zeros(1)}, tmp_path / "other.pth")
    with pytest.raises(CheckpointInvalid, match=r"Real-ESRGAN \(RRDBNet .*SwinIR and NAFNet"):
        read_network(tmp_path / "other.pth")
    (tmp_path / "text.pth").write_text("weights", "utf-8")
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_network(tmp_path / "text.pth")
    with pytest.raises((CheckpointInvalid, NotInCheckpoint), match="is missing"):
        read_network(tmp_path / "absent.pth")


def test_the_command_exports_and_declares_the_scale(tmp_path: Path) -> None:
    file = write_enhancer(tmp_path / "network.pth", "compact", scale=2)
    words = ["export", "enhance", "--checkpoint", str(file), "--size", "16x12"]
    words += ["-o", str(tmp_path / "x2.onnx"), "--level", "static"]
    completed = CliRunner().invoke(build(), words)
    assert completed.exit_code == 0, completed.output
    assert "Real-ESRGAN (SRVGGNetCompact) × 2" in completed.stderr
    model = onnx.load(tmp_path / "x2.onnx")
    assert [dim.dim_value for dim in model.graph.output[0].type.tensor_type.shape.dim] == [
        1,
        3,
        24,
        32,
    ]
    assert '"scale": 2' in model.metadata_props[0].value

"""`gsgen export package.module:factory`, as a user types it."""

import json
import math
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from gsgen.cli.commands.exporting import export as export_command
from gsgen.cli.commands.exporting.export import app
from gsgen.cli.commands.exporting.export_options import ExportRequest, with_common_options
from gsgen.cli.commands.exporting.export_report import ExportOutcome, emit_report
from gsgen.cli.commands.exporting.plugin_function import plugin_function
from gsgen.conformance.fixtures import find
from gsgen.contract._entry_points import Extension, ExtensionUnusable
from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName
from gsgen.contract.model.model_file import open_model
from gsgen.contract.validation.agreement import FieldError
from gsgen.contract.validator import validate
from gsgen.sdk import GeneratorInvalid, ParityFailed, export
from gsgen.sdk.parity import Parity
from gsgen.sdk.plugins.factory import load_factory
from gsgen.sdk.plugins.plugin import Plugin
from support.commands import gsgen

MODULE = """
import math
from pathlib import Path
from typing import Literal

import torch
from gsgen.sdk import GaussianGenerator, Gaussians, inputs


class Dots(GaussianGenerator):
    inputs = (inputs.time(),)

    def __init__(self, n: int = 8, color: Literal["red", "blue"] = "red", size=0.05) -> None:
        super().__init__()
        self.color = torch.tensor([1.0, 0, 0] if color == "red" else [0, 0, 1.0])
        self.n, self.size = n, size

    def forward(self, time):
        line = torch.linspace(0, 1, self.n)[:, None]
        ones = torch.ones(self.n, 3)
        return Gaussians(
            position=line * torch.tensor([1.0, 0.5, 0.2]) + time,
            opacity=0.8 * ones[:, 0],
            scale=self.size * ones,
            rotation=torch.tensor([1.0, 0, 0, 0]) * torch.ones(self.n, 1),
            rgb=self.color * ones,
        )


class Tall(Dots):
    def forward(self, time):
        made = super().forward(time)
        return Gaussians(
            made.position, made.opacity + 0.4 * torch.linspace(0, 1, self.n), made.scale, made.rotation, rgb=made.rgb
        )


class Choosy(Dots):
    def forward(self, time):
        return super().forward(time if time > 0.5 else -time)


def from_file(path: Path, n: int):
    return Dots(n) if path.is_file() else None


def failing(n: int = 3):
    raise ValueError(f"no such scene: {n}")


def anything(**options):
    return Dots(len(options))


class Gpu(Dots):
    # As training code: a device, a kernel of CUDA that is not called, and a warning.
    def __init__(self) -> None:
        import warnings

        from simple_knn._C import distCUDA2

        warnings.warn("torch.load may run code", FutureWarning, stacklevel=2)
        super().__init__()
        self.color = self.color.cuda()

    def forward(self, time):
        return super().forward(time.to("cuda"))


finished = Dots(5)
plain = torch.nn.Linear(2, 2)
number = 3
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "dots.py").write_text(MODULE)
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "scenes.py").write_text("from dots import Dots\n")
    (tmp_path / "broken.py").write_text("import torch\nx = torch.ones(2) @ torch.ones(3)\n")
    (tmp_path / "typo.py").write_text("def f(:\n    pass\n")
    (tmp_path / "lacking.py").write_text("import no_such_package\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("dots", "pack", "pack.scenes", "broken", "typo", "lacking"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def error_of(*words: str) -> GsgenError:
    completed = run(*words)
    assert isinstance(completed.exception, GsgenError), completed.output
    return completed.exception


def test_a_factory_is_exported_with_typed_arguments(folder: Path) -> None:
    """As a user does it: another process, options in front of the target."""
    completed = gsgen(
        *("export", "-o", "out/dots.onnx", "dots:Dots", "--arg", "n=12", "--arg"),
        *("color=blue", "--arg", "size=0.1", "--dtype", "float16", "--capacity", "16"),
        *("--name", "my dots", "--opset", "19", "--target", "webgpu", "--report", "r.json"),
        *("--level", "live"),
        cwd=folder,
        env={"VK_DRIVER_FILES": "/nonexistent"},
    )
    assert completed.code == 0, completed.err
    assert "out/dots.onnx: 16 rows, float16" in completed.out
    assert "conforms at level behaviour, live skipped" in completed.out
    assert "no usable WebGPU adapter" in completed.out
    assert "agrees with torch at 13 probes: position" in completed.out
    opened = open_model(folder / "out" / "dots.onnx")
    assert opened.proto.opset_import[0].version == 19
    document = json.loads((folder / "r.json").read_text())
    assert document["schema"] == "gsgen-export/1"
    assert (document["source"], document["written"], document["error"]) == ("dots:Dots", True, None)
    assert document["options"]["capacity"] == 16
    assert document["options"]["opset"] == 19
    assert isinstance(document["rewrites"], list)
    assert {field["field"] for field in document["parity"]["fields"]} == {
        *("position", "covariance", "opacity", "appearance")
    }
    assert document["validation"]["verdict"] == "conforms"
    assert document["validation"]["target"].startswith("webgpu")
    assert validate(folder / "out" / "dots.onnx").name == "my dots"


def test_the_hint_of_a_refused_module_stands_on_a_line_of_its_own(folder: Path) -> None:
    completed = run("dots:Choosy", "-o", "m.onnx")
    assert completed.exit_code == 1
    first, hint, last = completed.output.strip().splitlines()[-3:]
    assert first.startswith("gsgen: dots.py:")
    assert hint.startswith("  torch.where(condition, a, b)")
    assert last == "gsgen: m.onnx was not written"


def test_nonconforming_model_is_reported_and_not_written(folder: Path) -> None:
    completed = run("dots:Tall", "-o", "m.onnx", "--report", "r.json")
    assert completed.exit_code == 1
    assert "GV003 error opacity-range" in completed.output
    assert "gsgen: m.onnx was not written" in completed.output
    assert not (folder / "m.onnx").exists()
    document = json.loads((folder / "r.json").read_text())
    assert document["written"] is False
    assert document["stages"][0]["name"] == "building the generator"
    assert document["error"]["kind"] == "ExportRejected"
    assert document["validation"]["counts"]["error"] == 1


def test_torch_export_failure_is_reported_with_its_line(folder: Path) -> None:
    completed = run("dots:Choosy", "-o", "m.onnx", "--report", "r.json", "--no-rewrite")
    assert completed.exit_code == 1
    assert "super().forward(time if time > 0.5 else -time)" in completed.output
    assert "torch.where" in completed.output
    document = json.loads((folder / "r.json").read_text())
    assert document["error"]["kind"] == "ExportFailed"
    assert "dots.py:" in document["error"]["where"]
    assert document["options"]["rewrite"] is False
    assert (document["parity"], document["validation"]) == (None, None)
    assert not (folder / "m.onnx").exists()


def test_report_states_the_parity_error() -> None:
    worst_field = FieldError(
        field="position", error=math.inf, excess=math.inf, probe="time=1", row=3
    )
    error = ParityFailed("off", where="m.onnx", parity=Parity((worst_field,), 13))
    outcome = ExportOutcome(written=False, parity=error.parity, error=error)
    request = ExportRequest(output=Path("m.onnx"), report=Path("r.json"))
    emit_report(request, "dots:Dots", outcome)
    document = json.loads(Path("r.json").read_text(encoding="utf-8"))
    assert document["error"]["kind"] == "ParityFailed"
    assert document["parity"] == {
        "probes": 13,
        "rows_at_a_threshold": 0,
        "fields": [
            {
                "field": "position",
                "probe": "time=1",
                "row": 3,
                "error": None,
                "share_of_allowed": None,  # JSON has no infinity
            }
        ],
    }


@pytest.mark.parametrize(
    ("target", "arguments"),
    [
        ("dots:finished", []),
        ("pack.scenes:Dots", ["n=5"]),
        ("dots.py:Dots", ["n=5"]),
        ("dots:from_file", ["path=dots.py", "n=5"]),
        ("dots:anything", ["a=1", "b=2", "c=3", "d=4", "e=5"]),
    ],
)
def test_targets_of_every_sort_give_a_generator(target: str, arguments: list[str]) -> None:
    factory = load_factory(target)
    built = factory.build(factory.arguments(arguments))
    assert built.n == 5


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["dot:Dots"], UnknownName, "Did you mean 'dots'?"),
        (["pack.scene:Dots"], UnknownName, "Did you mean 'pack.scenes'?"),
        (["dots:Dot"], UnknownName, "Did you mean 'Dots'?"),
        (["dots:"], ConfigInvalid, "package.module:factory"),
        (["./dots:Dots"], ConfigInvalid, "Write ./dots.py:Dots"),
        (["dots"], UnknownName, "dots:NAME"),
        (["dots.py"], UnknownName, "dots.py:NAME"),
        (["pack.scenes.Dots"], UnknownName, "Write pack.scenes:Dots"),
        (["pack.scenes"], UnknownName, "pack.scenes:NAME"),
        (["dots.Dots"], UnknownName, "Write dots:Dots"),
        (["sttic"], UnknownName, "Did you mean 'static'?"),
        (["scene.ply"], UnknownName, "gsgen export static scene.ply"),
        (["scene.glb"], UnknownName, "gsgen export static scene.glb"),
        (["scene.sog"], UnknownName, "gsgen export static scene.sog"),
        (["dots:number"], GeneratorInvalid, "returns int, expected a GaussianGenerator"),
        (["dots:plain"], GeneratorInvalid, "gsgen.sdk.wrap"),
        (["dots:Dots", "--arg", "m=3"], UnknownName, "unknown argument 'm'"),
        (["dots:Dots", "--arg", "n"], ConfigInvalid, "'n' has no '='"),
        (["dots:Dots", "--arg", "n=x"], ConfigInvalid, "--arg n: 'x' is not a whole"),
        (["dots:Dots", "--arg", "color=red,"], ConfigInvalid, "one of red, blue"),
        (["dots:Dots", "--arg", "size=big"], ConfigInvalid, "'big' is not a number"),
        (["dots:from_file"], ConfigInvalid, "Add --arg path=… --arg n=…"),
        (["dots:Dots", "--target", "webgp"], UnknownName, "Did you mean 'webgpu'?"),
        (["dots:Dots", "--level", "liv"], ConfigInvalid, "live"),
        (["broken:f"], GsgenError, "broken.py:2 (x = torch.ones(2) @ torch.ones(3))"),
        (["typo:f"], GsgenError, "typo.py:1: SyntaxError: invalid syntax"),
        (["lacking:f"], GsgenError, "No module named 'no_such_package'"),
        (["dots:failing"], GsgenError, "ValueError: no such scene: 3"),
    ],
)
def test_mistyped_target_is_named_with_suggestions(
    folder: Path, words: list[str], error: type[GsgenError], message: str
) -> None:
    if error is GeneratorInvalid:  # no wrong word, but a module that is no generator
        completed = run(*words, "-o", "m.onnx")
        assert completed.exit_code == 1
        assert message in completed.output
    else:
        caught = error_of(*words, "-o", "m.onnx")
        assert isinstance(caught, error)
        assert message in str(caught)
    assert not (folder / "m.onnx").exists()


def test_help_lists_factory_arguments() -> None:
    message = " ".join(run("dots:Dots", "--help").output.replace("│", " ").split())
    assert "--arg n: int = 8" in message
    assert "color: Literal['red', 'blue'] = 'red'" in message
    assert "--no-rewrite" in message


def test_model_file_is_refused_as_target() -> None:
    model = find("drift").write(Path())
    assert "gsgen validate" in str(error_of(str(model), "-o", "m.onnx"))


def test_a_plugin_is_built_or_commands_by_itself() -> None:
    facts = {"name": "it", "summary": "It.", "reads": "Reads it.", "inputs": ()}
    for both in ({}, {"command": print, "build": print}):
        with pytest.raises(TypeError, match="both or neither of command and build"):
            Plugin(**facts, **both)
    assert plugin_function(Plugin(**facts, command=print)) is print


def test_a_plugin_s_own_options_stand_beside_the_common_ones() -> None:
    received: dict[str, object] = {}

    def build(file: Path, frames: int = 3) -> object:
        return (file, frames)

    def run_it(make, request) -> None:
        received.update(made=make(), request=request)

    import typer

    single = typer.Typer()
    single.command()(with_common_options(build, run_it))
    completed = CliRunner().invoke(single, ["a.pt", "-o", "m.onnx", "--frames", "9"])
    assert completed.exit_code == 0, completed.output
    assert received["made"] == (Path("a.pt"), 9)
    assert received["request"].output == Path("m.onnx")  # type: ignore[attr-defined]

    def clashing(dtype: str) -> object:
        return dtype

    with pytest.raises(
        TypeError, match="parameter 'dtype' has the name of an option of every export"
    ):
        with_common_options(clashing, run_it)


def clashing(dtype: str) -> object:
    return dtype


CLASHING = Plugin(
    name="clashing", summary="It clashes.", reads="Reads nothing.", inputs=(), build=clashing
)


def test_a_plugin_that_cannot_be_used_spoils_only_itself(
    monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    values = {"absent": "no_such_module:PLUGIN", "clashing": f"{__name__}:CLASHING"}
    points = {
        name: Extension(name, EntryPoint(name, value, "gsgen.generators"))
        for name, value in values.items()
    }
    monkeypatch.setitem(sys.modules, __name__, sys.modules[clashing.__module__])
    monkeypatch.setattr(export_command, "find_plugins", lambda: points)
    assert "It clashes." in CliRunner().invoke(app, ["--help"]).output
    completed = CliRunner().invoke(app, ["absent", "file", "-o", "m.onnx"])
    assert isinstance(completed.exception, ExtensionUnusable)
    assert completed.exception.exit_code == 3
    assert "No module named 'no_such_module'" in str(completed.exception)
    completed = CliRunner().invoke(app, ["clashing", "file", "-o", "m.onnx"])
    assert isinstance(completed.exception, GsgenError)
    assert "parameter 'dtype' has the name of an option of every export" in str(completed.exception)


def test_a_module_for_a_gpu_is_exported_with_a_stand_in_for_its_kernel(folder: Path) -> None:
    error = error_of("dots:Gpu", "-o", "m.onnx")
    assert "--stub simple_knn" in error.hint
    words = ("dots:Gpu", "-o", "m.onnx", "--stub", "simple_knn,unused", "--json")
    completed = run(*words, "--timeout", "300", "--skip", "merge-casts,mask-rows")
    assert completed.exit_code == 0, completed.output
    document = json.loads(completed.stdout)
    assert document["options"]["skip"] == ["merge-casts", "mask-rows"]
    assert document["options"]["timeout"] == 300
    assert document["constants"] is None
    names = [stage["name"] for stage in document["stages"]]
    assert names[:4] == [
        "building the generator",
        "running the module in eager torch",
        "tracing the graph",
        "rewriting the graph",
    ]
    assert all(stage["cpu_seconds"] >= 0 for stage in document["stages"])
    assert (
        "note: the module's code warns: FutureWarning: torch.load may run code" in completed.stderr
    )
    assert "simple_knn" not in sys.modules
    with pytest.raises(UnknownName, match="unknown pass 'no-pass'"):
        raise error_of("dots:Dots", "-o", "m.onnx", "--skip", "no-pass")


def test_samples_are_compared_and_must_be_the_declared_inputs(folder: Path) -> None:
    module = load_factory("dots:Dots", folder).build({})
    result = export(
        module, folder / "m.onnx", verify="quick", samples=[{"time": np.float32([0.37])}]
    )
    assert result.parity is not None
    without = export(module, folder / "m.onnx", verify="quick").parity
    assert without is not None
    assert result.parity.probes == without.probes + 1
    for sample, message in (
        ({"moment": np.zeros(1)}, r"has the inputs \['moment'\], expected \['time'\]"),
        ({"time": np.zeros(2)}, r"has the shape \[2\], expected \[1\]"),
    ):
        with pytest.raises(ConfigInvalid, match=message):
            export(module, folder / "m.onnx", samples=[sample])

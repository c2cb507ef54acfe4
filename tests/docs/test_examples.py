"""The guide "Export your method": its files are the examples, and its commands work."""

import re
import shlex
import textwrap
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from gsgen.cli.commands.exporting.export import app
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.validator import validate
from gsgen.sdk import Gaussians, math
from gsgen.sdk.exporting.tracing.hazards import _DESCRIPTIONS_AND_HINTS
from support.reports.pages import DOCS

PAGE = DOCS / "guides" / "export-your-method.md"
TEXT = PAGE.read_text("utf-8")
BLOCKS = dict(
    re.findall(r"^<!-- example: (\S+) -->\n```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
)
COMMANDS = re.findall(r"^gsgen export (\w+):\w+ .*$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("name", [name for name in BLOCKS if name.endswith(".py")])
def test_the_guide_shows_the_example_as_it_is(name: str) -> None:
    assert BLOCKS[name] == (DOCS / "examples" / name).read_text("utf-8")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_guide_s_command_exports_a_model_that_is_captured(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{name}.py").write_text(BLOCKS[f"{name}.py"], "utf-8")
    monkeypatch.chdir(tmp_path)
    (line,) = re.findall(rf"^gsgen export ({name}:.*)$", TEXT, re.MULTILINE)
    completed = CliRunner().invoke(app, shlex.split(line))
    assert completed.exit_code == 0, completed.output
    assert "conforms at level live" in completed.output
    assert "skipped" not in completed.output
    assert "warning" not in completed.output
    rewritten = re.search(r"^rewritten: (.*)$", completed.output, re.MULTILINE)
    assert rewritten is not None
    assert "end-on-compute (" in rewritten[1]
    shown = re.search(r"agrees with torch at 13 probes: (.*)", completed.output)
    assert shown is not None
    shares = [float(entry) for entry in re.findall(r"\(([\d.e+-]+) % of allowed\)", shown[1])]
    assert len(shares) == 4
    assert max(shares) <= 100
    manifest = loads(open_model(tmp_path / f"{name}.onnx").manifest_text or "")
    assert manifest.family == {"lit_mlp": "mlp", "deforming_cloud": "4d", "avatar": "avatar"}[name]
    assert validate(tmp_path / f"{name}.onnx").findings == ()


def test_all_three_examples_are_in_the_guide() -> None:
    assert COMMANDS == ["lit_mlp", "deforming_cloud", "avatar"]


class Network(torch.nn.Module):
    def forward(self, view: torch.Tensor, time: torch.Tensor) -> dict[str, torch.Tensor]:
        return {
            "xyz": torch.zeros(3, 3) + time,
            "logits": torch.zeros(3),
            "log_scales": torch.zeros(3, 3),
            "quats": torch.ones(3, 4),
            "colors": torch.ones(3, 3),
        }


def test_the_guide_s_way_to_wrap_a_module_works() -> None:
    names: dict[str, object] = {"network": Network()}
    exec(BLOCKS["wrap"], names)
    result = names["generator"](torch.eye(4), torch.ones(1))  # type: ignore[operator]
    assert isinstance(result, Gaussians)
    assert result.opacity.tolist() == [0.5, 0.5, 0.5]


def test_the_guide_s_way_to_return_cells_works() -> None:
    ones = torch.ones(6, 3)
    result = {
        "xyz": ones,
        "opacity": ones[:, 0],
        "scale": ones,
        "rotation": torch.ones(6, 4),
        "rgb": ones,
        "centre": ones[:2],
        "seen": ones[:2, 0],
        "size": ones[:2],
        "turn": torch.ones(2, 4),
    }
    names: dict[str, object] = {"network": lambda view: result}
    exec(BLOCKS["cells"], names)
    generator = names["Bunches"]()  # type: ignore[operator]
    inputs = generator(torch.eye(4))
    assert isinstance(inputs, Gaussians)
    assert inputs.cells.covariances().shape == (2, 6)
    assert generator.weighted_sum.depth_range == 20


def test_the_guide_s_way_to_cull_works() -> None:
    body = textwrap.indent(BLOCKS["cull"], "    ")
    names: dict[str, object] = {"math": math}
    exec(f"def cull(made, view, projection):\n{body}", names)
    ones = torch.ones(3, 3)
    gaussians = Gaussians(ones, ones[:, 0], ones, torch.ones(3, 4), rgb=ones)
    culled = names["cull"](gaussians, torch.zeros(4, 4), torch.zeros(4, 4))  # type: ignore[operator]
    assert culled.count.tolist() == [3]


def test_the_guide_names_every_helper_and_every_hazard() -> None:
    named = set(re.findall(r"`(\w+)`", TEXT))
    assert set(math.__all__) <= named
    table = TEXT.partition("| in forward, where an input reaches `x` |")[2].partition("\n\n")[0]
    assert len(re.findall(r"^\| `", table, re.MULTILINE)) == len(_DESCRIPTIONS_AND_HINTS)

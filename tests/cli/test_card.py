"""`gsgen card`: a model card with the verdict of its model, and a picture where one can be drawn."""

import io
from pathlib import Path

import onnx
import yaml
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.reference_plugins.samples import write_samples
from support.commands import gsgen_here


def front_matter(text: str) -> dict[str, object]:
    _, yaml_text, _ = text.split("---\n", 2)
    document = yaml.safe_load(yaml_text)
    assert isinstance(document, dict)
    return document


def test_a_card_says_what_the_model_is(tmp_path: Path) -> None:
    write_samples(tmp_path)
    result = gsgen_here("card", "sunflower.onnx", "-o", "README.md", cwd=tmp_path)
    assert result.code == 0, result.err
    text = (tmp_path / "README.md").read_text("utf-8")
    assert front_matter(text)["tags"] == [
        "gaussian-splatting",
        "3dgs",
        "onnx",
        "gaussian-generator",
    ]
    for part in ("# sunflower", "| `pose` | pose | [3, 3] | -1 to 1 | zeros | axis-angle |"):
        assert part in text
    assert "> conforms: " in text
    assert "](README.png)" in text
    with Image.open(io.BytesIO((tmp_path / "README.png").read_bytes())) as picture:
        assert picture.convert("L").getextrema()[1] > 100


def test_the_card_of_a_broken_model_names_the_finding(tmp_path: Path) -> None:
    path = find("opacity_is_logits").write(tmp_path)
    result = gsgen_here("card", path)
    assert result.code == 1
    assert "> invalid: " in result.out
    assert "- GV003 error: " in result.out
    assert "![" not in result.out
    assert list(tmp_path.iterdir()) == [path]


def test_a_model_without_a_manifest_has_no_card(tmp_path: Path) -> None:
    path = find("opacity_is_logits").write(tmp_path)
    model = onnx.load(path)
    del model.metadata_props[:]
    path.write_bytes(model.SerializeToString())
    result = gsgen_here("card", path)
    assert result.code == 2
    assert "has no valid manifest" in result.err


def test_a_card_never_replaces_its_model(tmp_path: Path) -> None:
    path = find("opacity_is_logits").write(tmp_path)
    assert gsgen_here("card", path, "-o", path).code == 2
    onnx.load(path)
    missing = gsgen_here("card", tmp_path / "absent.onnx")
    assert missing.code == 4
    assert "Traceback" not in missing.err

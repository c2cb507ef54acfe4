"""Writes a model card: the README.md of a model in a repository such as the Hugging Face Hub.

The front matter is that of the Hub's model cards, https://huggingface.co/docs/hub/model-cards.
"""

__all__ = ["model_card"]

from urllib.parse import quote

from gsgen.contract._safe_text import for_markdown, for_shell, for_yaml
from gsgen.contract.reporters.markdown import code
from gsgen.contract.reporters.summary import verdict_line
from gsgen.contract.spec.manifest import GeneratorManifest, Input, Manifest
from gsgen.contract.spec.units import format_bytes
from gsgen.contract.validation.report import Report

_KIND_TEXTS = {
    "gaussian-generator": "a Gaussian Generator: an ONNX model that turns its inputs into 3D "
    "Gaussians, every frame",
    "post-process": "a post-process model: an ONNX model that redraws a rendered image",
    "trajectory-predictor": "a trajectory predictor: an ONNX model that predicts camera paths",
}


def model_card(report: Report, manifest: Manifest, file: str, picture: str = "") -> str:
    """Return a model card in Markdown, for the README.md of a model's repository.

    Args:
        report: The validation of the model.
        manifest: The model's manifest.
        file: Name of the model's file in the repository.
        picture: Name of a picture beside the card; empty for none.
    """
    producer = manifest.producer
    licence = producer.license if producer and producer.license else ""
    tags = ["gaussian-splatting", "3dgs", "onnx", manifest.kind]
    front_matter = ["---", *([f"license: {for_yaml(licence.lower())}"] if licence else [])]
    front_matter += ["library_name: gsgen", "tags:", *(f"- {for_yaml(tag)}" for tag in tags), "---"]
    title = f"# {for_markdown(manifest.name or file)}"
    summary = f"{code(file)} ({format_bytes(report.size)}) is {_KIND_TEXTS[manifest.kind]}."
    sections = ["\n".join(front_matter), title]
    if picture:
        probe = report.picture.probe if report.picture else ""
        alt_text = for_markdown(f"The model drawn at the probe {probe}")
        sections.append(f"![{alt_text}]({quote(picture)})")
    sections.append(summary)
    if producer:
        source = f" from {code(producer.source)}" if producer.source else ""
        sections.append(f"It was written by {code(producer.tool)}{source}.")
    sections += ["## Inputs", _input_table(manifest.inputs)]
    if isinstance(manifest, GeneratorManifest):
        sections += ["## Outputs", _outputs(manifest)]
    checked = (
        f"Validated for target {code(report.target.name)} at level {report.level.word}, "
        f"contract {for_markdown(report.contract)}:"
    )
    sections += ["## Verdict", checked, f"> {for_markdown(verdict_line(report))}"]
    findings = [f"- {f.rule} {f.severity.word}: {code(f.message)}" for f in report.findings]
    sections += ["\n".join(findings)] if findings else []
    word = for_shell(file)
    commands = [f"gsgen validate {word}", f"gsgen inspect {word}"]
    if isinstance(manifest, GeneratorManifest):
        commands.append(f"gsgen render {word} -o picture.png")
    sections += ["## Use", "\n".join(["```bash", *commands, "```"])]
    return "\n\n".join(sections) + "\n"


def _input_table(inputs: tuple[Input, ...]) -> str:
    if not inputs:
        return "None: the model is static."
    lines = ["| name | role | shape | range | default | convention |", "|---|---|---|---|---|---|"]
    for entry in inputs:
        default = "" if entry.default is None else str(entry.default)
        shape = "" if entry.shape is None else str(list(entry.shape))
        span = "" if entry.range is None else f"{entry.range[0]:g} to {entry.range[1]:g}"
        name = code(entry.name).replace("|", "\\|")
        role, default, convention = map(for_markdown, (entry.role, default, entry.convention or ""))
        cells = (name, role, shape, span, default, convention)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _outputs(manifest: GeneratorManifest) -> str:
    outputs, lines = manifest.outputs, []
    if outputs.gaussians:
        gaussians = outputs.gaussians
        lines.append(f"- {gaussians.capacity:,} rows of Gaussians, {gaussians.dtype}")
    if outputs.appearance:
        appearance = outputs.appearance
        degree = f" of degree {appearance.degree}" if appearance.space == "sh" else ""
        lines.append(f"- colours as {appearance.space}{degree}, {appearance.color_space}")
    if manifest.bounds:
        lines.append(f"- within {list(manifest.bounds.min)} to {list(manifest.bounds.max)}")
    return "\n".join(lines)

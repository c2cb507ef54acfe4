"""The command `gsgen inspect`: shows an ONNX model's declarations, or infers its manifest."""

__all__ = ["inspect"]

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gsgen.cli.output import echo, echo_json, echo_text
from gsgen.contract._safe_text import safe_json
from gsgen.contract.errors import ConfigInvalid, ExitCode

if TYPE_CHECKING:
    from gsgen.contract.model.inspected_model import InspectedModel


def inspect(
    model: Annotated[Path | None, typer.Argument(help="The ONNX file.", show_default=False)] = None,
    emit_manifest: Annotated[
        bool, typer.Option("--emit-manifest", help="Print the manifest, or a derived one, as JSON.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
    schema: Annotated[
        str | None, typer.Option(help="Print the JSON Schema of a kind of manifest instead.")
    ] = None,
) -> None:
    """Show a model's inputs, outputs and manifest; its weights are not read.

    Of a splat file, or of the folder of a 3DGS training, the number of splats is shown, and the
    range of their positions, sizes, opacities and colours.

    With --emit-manifest, a model without a manifest gets one derived from names and shapes; what
    had to be guessed is listed on stderr.
    """
    if schema is not None:
        echo_json(_schema(schema))
        return
    if model is None:
        raise ConfigInvalid("MODEL is missing, expected an ONNX file or --schema KIND")
    if not emit_manifest and _is_splats(model):
        _show_splats(model, as_json=as_json)
        return
    subject = _read(model)
    if emit_manifest:
        _emit_manifest(subject)
    elif as_json:
        echo_json(_model_facts(subject))
    else:
        _print_model(subject)


def _is_splats(path: Path) -> bool:
    """Return whether a path is that of a splat file, or of the folder of a 3DGS training."""
    from gsgen.formats.codecs import codec_of_suffix
    from gsgen.formats.inputs import training_folder

    return path.exists() and (bool(codec_of_suffix(path)) or training_folder(path) is not None)


def _show_splats(path: Path, *, as_json: bool) -> None:
    from gsgen.formats import Splats, open_splats
    from gsgen.formats.editing.statistics import statistics_text, summarise

    content = open_splats(path)
    summary = summarise(content) if isinstance(content, Splats) else ()
    facts = {
        "path": str(path),
        "splats": len(content),
        "sh_degree": content.degree if isinstance(content, Splats) else None,
        "statistics": [asdict(entry) for entry in summary],
    }
    if as_json:
        echo_json(facts)
    elif isinstance(content, Splats):
        echo(f"{path}: {len(content):,} splats of SH degree {content.degree}")
        echo(*statistics_text(summary).split("\n"))
    else:
        echo(f"{path}: {len(content):,} points")


def _schema(kind: str) -> dict[str, object]:
    from gsgen.contract.errors import UnknownName
    from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
    from gsgen.contract.spec.manifest_io import schema_name, schemas

    if kind not in MANIFEST_KINDS:
        raise UnknownName.among("kind", kind, MANIFEST_KINDS, "--schema")
    return schemas()[schema_name(kind)]


def _read(model: Path) -> "InspectedModel":
    from gsgen.contract.model.inspected_model import inspect_model
    from gsgen.contract.model.model_file import open_model
    from gsgen.contract.process.limits import Limits
    from gsgen.contract.spec.targets import load_target

    return inspect_model(open_model(model), load_target("core"), Limits())


def _emit_manifest(subject: "InspectedModel") -> None:
    from gsgen.contract.spec.manifest_io import dumps

    if subject.parsed is not None and subject.parsed.manifest is None:
        echo_text(subject.file.manifest_text or "")
        echo("this manifest is invalid: see `gsgen validate --level static`", err=True)
        raise typer.Exit(ExitCode.FAILURE)
    manifest = subject.manifest
    assert manifest is not None
    echo_text(safe_json(dumps(manifest)))
    if subject.candidate is not None:
        echo(f"{subject.file.path} has no manifest; this one is derived. Confirm:", err=True)
        for manifest_guess in subject.candidate.manifest_guesses:
            echo(f"  - {manifest_guess}", err=True)


def _model_facts(subject: "InspectedModel") -> dict[str, Any]:
    file, graph = subject.file, subject.graph
    text = file.manifest_text
    opsets = {entry.domain or "ai.onnx": entry.version for entry in file.proto.opset_import}
    return {
        "path": str(file.path),
        "bytes": file.size,
        "ir_version": file.proto.ir_version,
        "opsets": opsets,
        "producer": f"{file.proto.producer_name} {file.proto.producer_version}".strip(),
        "nodes": sum(1 for _ in graph.all_nodes()),
        "weights": len(graph.initializers),
        "inputs": [_tensor_facts(t.name, t.dtype, t.dims) for t in graph.inputs],
        "outputs": [_tensor_facts(t.name, t.dtype, t.dims) for t in graph.outputs],
        "manifest": json.loads(text) if text and subject.manifest else None,
    }


def _tensor_facts(name: str, dtype: str | None, dims: object) -> dict[str, object]:
    return {"name": name, "dtype": dtype, "shape": dims}


def _print_model(subject: "InspectedModel") -> None:
    facts, graph = _model_facts(subject), subject.graph
    opsets = ", ".join(f"{domain} {number}" for domain, number in facts["opsets"].items())
    echo(f"{facts['path']}: {facts['bytes']:,} B, opset {opsets}, {facts['nodes']} nodes")
    roles = {i.name: i.role for i in subject.manifest.inputs} if subject.manifest else {}
    for tensor in graph.inputs:
        echo(f"  input   {tensor.name}: {tensor}  {roles.get(tensor.name, '')}".rstrip())
    for tensor in graph.outputs:
        echo(f"  output  {tensor.name}: {tensor}")
    if subject.parsed is None:
        echo("  no manifest: `gsgen inspect MODEL --emit-manifest` derives one")
    elif subject.manifest is None:
        echo("  the manifest is invalid: see `gsgen validate --level static`")
    else:
        from gsgen.contract.spec.manifest_io import dumps

        echo("  manifest:")
        for line in safe_json(dumps(subject.manifest)).split("\n"):
            echo(f"    {line}")

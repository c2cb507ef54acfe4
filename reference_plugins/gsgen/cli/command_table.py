"""The commands of the `gsgen` program as data: name, summary, module, and the extra they need."""

__all__ = ["PANELS", "Command", "advice_on", "calls_meant", "find_command", "panels"]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint
from typing import Final

from gsgen.contract._entry_points import Extension, find_extensions
from gsgen.contract.errors import names_meant

_ENTRY_POINT_GROUP: Final = "gsgen.commands"
_ROOT_OPTION_WORDS: Final = {
    "--version": "version",
    "--help": "usage commands",
    "--install-completion": "completion completions complete autocomplete",
}
_SUBCOMMAND_WORDS: Final = {
    "tiles build": "create make convert generate tile split lod merge optimize optimise",
    "tiles info": "inspect show stats statistics list ls tree analyze analyse",
    "tiles pack": "zip archive 3tz package bundle tilesettodatabase",
    "tiles score": "compare psnr ssim quality",
    "tiles serve": "host server http",
    "tiles simulate": "stream network bench benchmark",
    "viewer-kit check": "compare run test verify validate score",
    "viewer-kit write": "export create make save generate init",
}
"""Call → the words for it after the name of its group, separated by spaces."""

_ADVICE: Final = {
    "gsgen trains nothing: `gsgen export METHOD` reads what training wrote, and `gsgen plugins` "
    "lists the methods.": (
        "train training fit ns-train ns-process-data process-data colmap sfm dataset simple-trainer"
    ),
    "pip does that: `pip install -U gsgen`; `gsgen doctor` prints the lines for missing parts.": (
        "install uninstall update upgrade self-update pip"
    ),
    "Give an address (https, hf, s3, …) in place of a file; nothing is ever uploaded.": (
        "pull push fetch download upload clone login get"
    ),
    "`gsgen references` declares pictures of a model, `gsgen validate --level render` compares.": (
        "psnr ssim lpips metrics eval ns-eval evaluate score"
    ),
    "Files are read as they are: `gsgen render FILE` draws one.": "import load read ingest",
    "gsgen draws meshes, and makes none of splats.": "mesh extract-mesh marching-cubes tsdf poisson",
    "Settings stand in gsgen.toml, or in [tool.gsgen] of pyproject.toml.": "config set-config settings",
}
"""Sentence → the words for what no command does."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the `gsgen` program, whose code is imported when it runs.

    Attributes:
        name: The word that users type after ``gsgen``.
        summary: The first paragraph of the command's help.
        code: The typer function, or the :class:`typer.Typer`.
        words: Call, such as ``tiles serve`` → the words that people type for it, separated by
            spaces; also words of neighbouring programs.
    """

    name: str
    summary: str
    code: Extension
    words: Mapping[str, str] = field(default_factory=dict)


def _make_command(
    name: str, summary: str, module_path: str, words: str = "", **words_by_suffix: str
) -> Command:
    """Return a command of ours.

    Args:
        name: The word that users type.
        summary: The first paragraph of the command's help.
        module_path: Its module and function below gsgen.cli.commands.
        words: Other words for it.
        words_by_suffix: Words for a subcommand or, after ``__``, for an option.
    """
    point = EntryPoint(name, f"gsgen.cli.commands.{module_path}", _ENTRY_POINT_GROUP)
    calls = {f"{name} {key.replace('__', '--')}": text for key, text in words_by_suffix.items()}
    return Command(name, summary, Extension(name, point), {name: words} | calls)


PANELS: Final[dict[str, tuple[Command, ...]]] = {
    "Start": (
        _make_command(
            "samples",
            "Write sample files into DIR: a garden of splats, cameras, a generator and a motion for it.",
            "exporting.samples:samples",
            "example examples demo demos quickstart tutorial sample start",
        ),
        _make_command(
            "doctor",
            "Show versions, drivers and adapters, and how to install missing parts.",
            "checking.doctor:doctor",
            "env environment diagnose diagnostics system gpu gpus selftest setup versions devices",
        ),
        _make_command(
            "new",
            "Create a plugin package NAME: a method, its export command, and passing tests.",
            "exporting.new:new",
            "init create scaffold template project cookiecutter",
        ),
    ),
    "Export generators": (
        _make_command(
            "export",
            "Export a Gaussian Generator from your torch module, or from the files of a method.",
            "exporting.export:app",
            "onnx to-onnx ns-export onnx-export build",
            sequence="sequence flipbook ply-sequence",
            html="html page webpage website embed publish share threejs three babylon playcanvas",
        ),
        _make_command(
            "plugins",
            "List the installed plugins: method, model inputs, and the files that each reads.",
            "exporting.plugins:plugins",
            "list ls methods models method plugin families supported available",
        ),
        _make_command(
            "fix",
            "Write a repaired copy of MODEL, and list the changes.",
            "exporting.fix:fix [sdk]",
            "repair sanitize sanitise heal patch correct",
        ),
        _make_command(
            "rewrite",
            "Rewrite MODEL's graph for a target GPU, and verify that it computes the same outputs.",
            "exporting.rewrite:rewrite [sdk]",
            "simplify optimize optimise onnxsim onnxslim surgeon polygraphy-surgeon lower",
        ),
        _make_command(
            "float16",
            "Write a float16 copy of MODEL; nodes whose rounding error is too large stay float32.",
            "exporting.float16:float16 [sdk]",
            "fp16 half quantize quantise quantization float32 fp32 precision int8 uint8 bf16 bfloat16",
        ),
    ),
    "Check models": (
        _make_command(
            "validate",
            "Check whether the given ONNX models conform to the Gaussian Generator contract.",
            "checking.validate:validate",
            "check lint verify test validator checker polygraphy conform",
            __help="targets levels",
        ),
        _make_command(
            "inspect",
            "Show a model's inputs, outputs and manifest; its weights are not read.",
            "checking.inspect:inspect",
            "info probe ffprobe mediainfo identify graph nodes bounds bbox extent show describe summary summarize stats statistics netron print cat manifest metadata dump head shape shapes infer-shapes opset count tree",
        ),
        _make_command(
            "conformance",
            "Run conformance suites on each MODEL, and print a command that reproduces each failure.",
            "checking.conformance:conformance",
            "suite suites certify",
        ),
        _make_command(
            "repro",
            "Check one rule of MODEL again, with one probe (set of test inputs) if that is enough.",
            "checking.repro:repro",
            "reproduce reduce bisect debug",
        ),
        _make_command(
            "rules",
            "List every validation rule: id, severity, level, name and statement.",
            "checking.rules:rules",
            "rule codes list-rules checks",
        ),
        _make_command(
            "explain",
            "Explain what the rule RULE requires, why, and how to repair a model that breaks it.",
            "checking.explain:explain",
            "why doc docs what man error errors",
        ),
        _make_command(
            "diff",
            "Compare the declarations, the graphs and the outputs of two ONNX models.",
            "checking.diff:diff",
            "compare comparison difference cmp delta",
        ),
        _make_command(
            "references",
            "Write a copy of MODEL with reference images, drawn by MODEL or by its training code.",
            "drawing.references:references [runtime]",
            "reference golden goldens baseline",
        ),
        _make_command(
            "vectors",
            "Write test vectors of MODEL, and a copy of MODEL whose manifest lists them.",
            "checking.vectors:vectors",
            "testdata test-data record test-vectors",
        ),
        _make_command(
            "viewer-kit",
            "Test a viewer: small models, expected pictures, and a verdict for each test.",
            "checking.viewer_kit:app",
            "viewerkit kit viewer-test",
        ),
        _make_command(
            "card",
            "Write a model card of MODEL: description, inputs, a picture, and the validation verdict.",
            "checking.card:card",
            "model-card modelcard readme hf-card",
        ),
    ),
    "Draw and measure": (
        _make_command(
            "render",
            "Draw SCENES: splat files and meshes, and generators, which run for every frame.",
            "drawing.render:render [runtime]",
            "draw screenshot picture pic image snapshot video film movie animate ns-render thumbnail turntable png mp4 gif frame frames run infer inference predict gsplat",
        ),
        _make_command(
            "view",
            "Show SCENES in a window: orbit around them, play their time, and save pictures.",
            "drawing.view:view [runtime]",
            "viewer open display play gui window ns-viewer simple-viewer look watch preview interactive supersplat viser rerun",
            __web="serve web browser server host http online vr xr webxr",
        ),
        _make_command(
            "bench",
            "Measure the time and memory of a frame of each MODEL on each execution provider.",
            "exporting.bench:bench",
            "benchmark profile perf performance time timing speed fps onnxruntime-perf-test onnxruntime ort trtexec",
        ),
        _make_command(
            "bench-render",
            "Measure the time and the memory of a frame of SCENES, stage by stage.",
            "drawing.bench_render:bench_render [runtime]",
            "benchmark-render profile-render",
        ),
    ),
    "Splat files and tilesets": (
        _make_command(
            "convert",
            "Write the splats of SOURCE to TARGET in another format, and print the losses.",
            "drawing.convert:convert",
            "transform merge combine concat compress decompress pack unpack crop clip decimate prune clean filter rotate translate scale splat-transform ply spz sog splat glb gsbox trim edit resize denoise sample subsample downsample sort blender unity unreal pcd pointcloud",
            __help="formats suffixes",
        ),
        _make_command(
            "bake",
            "Write frames of a generator as plain splat files, which every viewer reads.",
            "drawing.bake:bake",
            "freeze unroll frames-to-ply snapshot-ply",
        ),
        _make_command(
            "tiles",
            "Build, look into and serve tilesets of splats: 3D Tiles 1.1, coarse above, fine below.",
            "tiles.group:app",
            "tileset",
            build="tile tiling lod 3dtiles 3d-tiles octree stream streaming split cesium",
            serve="serve server host http",
        ),
    ),
}
"""Panel → commands of gsgen, in the order of the help; other packages' commands come last."""


def find_command(name: str) -> Command | None:
    """Return the command ``name`` of gsgen or of another package; None if there is none.

    Other packages register theirs under the entry point group ``gsgen.commands``.
    """
    own_commands = {command.name: command for commands in PANELS.values() for command in commands}
    return own_commands.get(name) or _extension_commands().get(name)


def calls_meant(word: str, arguments: Sequence[str] = (), group: str = "") -> list[str]:
    """Return the calls, such as ``tiles serve``, that people mean by a word that names no command.

    Args:
        word: The typed word.
        arguments: The words after it: its subcommand, perhaps.
        group: The group in which it was typed, such as ``tiles``, whose calls count first.
    """
    own_words = {call: text for call, text in _SUBCOMMAND_WORDS.items() if call.split()[0] == group}
    by_last_word = {call.split()[1]: text for call, text in own_words.items()}
    if own_calls := names_meant(word, by_last_word):
        return [f"{group} {name}" for name in own_calls]
    commands = [command for panel in panels().values() for command in panel]
    words = {call: text for command in commands for call, text in command.words.items()}
    calls = names_meant(word, words | _ROOT_OPTION_WORDS)
    groups = [call.split()[0] for call in calls]
    return (
        [
            name if f"{name} {arguments[0]}" in _SUBCOMMAND_WORDS else call
            for name, call in zip(groups, calls, strict=True)
        ]
        if arguments
        else calls
    )


def advice_on(word: str) -> str:
    """Return what to do in place of a command that gsgen does not have; empty if unknown."""
    return next(iter(names_meant(word, _ADVICE)), "")


def panels() -> dict[str, tuple[Command, ...]]:
    """Return panel → commands of gsgen and of other packages, in the order of the help."""
    own_commands = {command.name for commands in PANELS.values() for command in commands}
    extension_commands = tuple(
        command for name, command in _extension_commands().items() if name not in own_commands
    )
    return PANELS | ({"Other commands": extension_commands} if extension_commands else {})


def _extension_commands() -> dict[str, Command]:
    return {
        name: Command(name, f"A command of the package {code.owner}.", code)
        for name, code in find_extensions(_ENTRY_POINT_GROUP).items()
    }

"""Draws a model for one set of test inputs (a probe), for HTML reports."""

__all__ = ["draw_probe"]

from importlib.util import find_spec
from pathlib import Path

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.recording import RecordingRefused, run_at_probes
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.errors import DeviceUnavailable


def draw_probe(path: Path, label: str, settings: Settings) -> bytes:
    """Run an ONNX generator with the test inputs called ``label``, and return a PNG picture.

    Raises:
        RecordingRefused: The model has no such probe, or does not run.
        DeviceUnavailable: No graphics device can be opened, or a package is missing.
        SceneInvalid: The outputs cannot be drawn.
    """
    for package in ("wgpu", "PIL"):
        if find_spec(package) is None:
            hint = "pip install 'gsgen[runtime]'"
            raise DeviceUnavailable(f"{package} is not installed", hint=hint)
    from gsgen.runtime.checks.level import probe_camera, scene_of
    from gsgen.runtime.checks.reference_image import BACKGROUND
    from gsgen.runtime.media.pictures import png_of
    from gsgen.runtime.renderer.renderer import Renderer

    subject = inspect_model(open_model(path), settings.target, settings.limits)
    manifest = subject.generator
    probes = make_plan(subject, Level.VALUES, settings.seed).probes if manifest else ()
    probe = next((probe for probe in probes if probe.label == label), None)
    if manifest is None or probe is None:
        raise RecordingRefused(
            f"the model has no test inputs (probe) of the label {label!r}",
            where=str(path),
            hint=f"The labels are {', '.join(repr(probe.label) for probe in probes) or 'unknown'}.",
        )
    with run_at_probes(subject, fetched_outputs(subject), [probe]) as execution:
        scene = scene_of(manifest, execution.samples[execution.runs[0].sample].outputs)
        camera = probe_camera(manifest, probe)
        frame = Renderer(rasteriser="tiles").render(scene, camera, background=BACKGROUND)
        return png_of(frame.srgb8[..., :3])

"""Checks the installation: versions, missing parts, and the commands that install them."""

__all__ = ["Check", "check_package", "checks"]

import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Final, Literal

from gsgen.contract.process.confinement import available_confinement

_RUNTIME: Final = "onnxruntime"
_PURPOSE: Final = "validate"

CheckState = Literal["ok", "missing", "broken"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The state of one dependency of gsgen, and the command that installs or repairs it.

    Attributes:
        name: The package, device or process.
        state: ``ok``, ``missing`` (some commands cannot run), or ``broken`` (it does not work).
        detail: A version, an adapter, or the fault.
        remedy: The command that repairs it; empty if the state is ``ok``.
        purpose: The commands or levels that need it.
    """

    name: str
    state: CheckState
    detail: str
    remedy: str = ""
    purpose: str = ""


def check_package(name: str, remedy: str, *, purpose: str = "") -> Check:
    """Check whether the distribution ``name`` is installed, without importing it."""
    try:
        return Check(name=name, state="ok", detail=version(name), purpose=purpose)
    except PackageNotFoundError:
        return Check(
            name=name, state="missing", detail="not installed", remedy=remedy, purpose=purpose
        )


def checks() -> Iterator[Check]:
    """Yield the version of each package that validation needs, or the command that repairs it."""
    yield Check(
        name="gsgen", state="ok", detail=f"{version('gsgen')} in {Path(__file__).parents[2]}"
    )
    yield Check(
        name="python", state="ok", detail=f"{platform.python_version()} at {sys.executable}"
    )
    for name in ("numpy", "onnx"):
        yield check_package(name, f"pip install {name}", purpose=_PURPOSE)
    yield _check_onnxruntime()
    yield _check_sandbox()
    yield from _check_confinement()


def _check_onnxruntime() -> Check:
    """Check which distribution brings ONNX Runtime: two overwrite each other's files."""
    names = sorted(set(packages_distributions().get(_RUNTIME, ())))
    if len(names) < 2:
        return check_package(
            names[0] if names else _RUNTIME, f"pip install {_RUNTIME}", purpose=_PURPOSE
        )
    # The plain one is a dependency of many packages; the other was chosen.
    chosen = next(name for name in names if name != _RUNTIME)
    return Check(
        name=_RUNTIME,
        state="broken",
        detail=f"{' and '.join(f'{name} {version(name)}' for name in names)} overwrite each other's files",
        remedy=f"pip uninstall -y {' '.join(names)} && pip install {chosen}",
        purpose=_PURPOSE,
    )


def _check_confinement() -> Iterator[Check]:
    """Yield what confines a model's process on this system, besides limits on time and memory."""
    confinement = available_confinement()
    purpose = "models of others"
    is_linux = sys.platform.startswith("linux")
    files_detail = f"Landlock {confinement.files}: a model's process reads no other file of yours"
    calls_detail = "seccomp: a model's process has no network, and starts no other"
    remedy = "Run models of others in a container, or on Linux 5.13 or newer."
    for name, is_package_available, detail, needed in (
        ("confined files", confinement.files, files_detail, "Landlock"),
        ("confined calls", confinement.calls, calls_detail, "seccomp"),
    ):
        missing_detail = f"this kernel has no {needed}" if is_linux else "Linux alone has it"
        yield Check(
            name=name,
            state="ok" if is_package_available else "missing",
            detail=detail if is_package_available else missing_detail,
            remedy="" if is_package_available else remedy,
            purpose=purpose,
        )


def _check_sandbox() -> Check:
    """Check that a minimal model runs in the sandbox (child process), as validation needs."""
    from onnx import ModelProto, NodeProto, TensorProto

    from gsgen.contract.errors import HostProcessFailed
    from gsgen.contract.probing.probes import Probe
    from gsgen.contract.probing.sandbox import Fault, execute
    from gsgen.contract.process.drafts import temporary_folder
    from gsgen.contract.process.limits import Limits

    model = ModelProto(ir_version=8)
    model.opset_import.add(domain="", version=18)
    weight = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[1], float_data=[1.0])
    model.graph.name = "smallest"
    model.graph.initializer.append(weight)
    model.graph.node.append(NodeProto(op_type="Neg", input=["w"], output=["y"]))
    value = model.graph.output.add(name="y").type.tensor_type
    value.elem_type = TensorProto.FLOAT
    value.shape.dim.add(dim_value=1)
    with temporary_folder() as folder:
        path = folder / "smallest.onnx"
        path.write_bytes(model.SerializeToString())
        probes, limits = [Probe(label="none", inputs={})], Limits(seconds=30)
        try:
            with execute(path, ["y"], probes, limits) as execution:
                fault, seconds = execution.fault, execution.seconds
        except HostProcessFailed as error:
            fault, seconds = Fault("crash", error.message), 0.0
    purpose = "levels values and behaviour"
    if fault is not None:
        return Check(
            name="sandbox",
            state="broken",
            detail=fault.message,
            remedy="pip install -U onnxruntime",
            purpose=purpose,
        )
    return Check(
        name="sandbox",
        state="ok",
        detail=f"a model ran in a child process ({seconds:.2f} s)",
        remedy="",
        purpose=purpose,
    )

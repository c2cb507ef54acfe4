"""Every error can be given another location, whichever arguments its class takes."""

import importlib
import inspect
import pkgutil
from types import ModuleType

import pytest

import gsgen.contract
import gsgen.formats
import gsgen.runtime
import gsgen.sdk
import gsgen.tiles
from gsgen.contract.errors import GsgenError


def _error_classes() -> list[type[GsgenError]]:
    for package in (gsgen.contract, gsgen.formats, gsgen.sdk, gsgen.runtime, gsgen.tiles):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.rpartition(".")[2] in ("errors", "_entry_points", "worker_pool"):
                loaded: ModuleType = importlib.import_module(module.name)
                assert loaded
    error_classes, pending = [], [GsgenError]
    while pending:
        error_class = pending.pop()
        error_classes.append(error_class)
        pending += error_class.__subclasses__()
    return error_classes


@pytest.mark.parametrize("error_class", _error_classes(), ids=lambda value: value.__qualname__)
def test_located_error_keeps_its_class_and_fields(error_class: type[GsgenError]) -> None:
    error = _example(error_class)
    located = error.located("scene.json: models[0]")
    assert type(located) is error_class
    assert located.where == "scene.json: models[0]"
    assert str(located).startswith("scene.json: models[0]: ")
    changed_fields = {"where", "path"}
    assert {name: value for name, value in vars(located).items() if name not in changed_fields} == {
        name: value for name, value in vars(error).items() if name not in changed_fields
    }


def _example(error_class: type[GsgenError]) -> GsgenError:
    arguments: dict[str, object] = {}
    for name, parameter in inspect.signature(error_class).parameters.items():
        if parameter.default is parameter.empty:
            arguments[name] = ("actual", "expected") if name == "fault" else f"the {name}"
    return error_class(**arguments)  # type: ignore[arg-type]

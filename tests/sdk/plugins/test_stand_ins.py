"""Packages that cannot be installed are imported as stand-ins, and are named when they are called."""

import importlib
import sys
import typing

import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.sdk.plugins.stand_ins import StandInCalled, stand_ins


def test_names_of_a_stand_in_are_imported_derived_from_and_annotated_with() -> None:
    with stand_ins(["simple_knn", "rasterization"]):
        simple_knn = importlib.import_module("simple_knn._C")
        kernels = importlib.import_module("rasterization.kernels")

        class Settings(kernels.Settings):
            width: int

        def draw(settings: kernels.Settings | None) -> simple_knn.Result | None: ...

        assert issubclass(Settings, kernels.Settings)
        assert typing.get_type_hints(draw)
        for function in (simple_knn.distCUDA2, Settings, kernels.Settings.default):
            with pytest.raises(StandInCalled, match="a stand-in of --stub has no code") as caught:
                function(1)
            assert function.__qualname__ in caught.value.where
    assert not {"simple_knn", "simple_knn._C", "rasterization.kernels"} & set(sys.modules)
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("simple_knn")


def test_an_installed_package_is_replaced_within_the_block_alone() -> None:
    json = importlib.import_module("json")
    with stand_ins(["json"]), pytest.raises(StandInCalled):
        importlib.import_module("json").loads("{}")
    assert importlib.import_module("json") is json


def test_a_name_that_is_no_module_is_refused() -> None:
    message = "'simple-knn' is not the name of a module"
    with pytest.raises(ConfigInvalid, match=message), stand_ins(["simple-knn"]):
        pass

"""wgpu's C types are found without being parsed one by one."""

from unittest.mock import patch

import numpy as np
from wgpu.backends.wgpu_native._ffi import ffi

from gsgen.runtime.gpu.native_types import parse_native_types


def test_pointers_to_all_types_are_known_without_parsing() -> None:
    names = ffi.list_types()[0]
    assert parse_native_types() >= 400
    with patch.object(ffi._parser, "parse_type", side_effect=AssertionError("parsed")):
        assert ffi.sizeof(ffi.new("WGPULimits *")[0]) > 100
        pointers = {name: ffi.typeof(f"{name} *") for name in names}
    for name in np.random.default_rng(7).choice(sorted(pointers), 5, replace=False):
        assert pointers[name].item is ffi.typeof(str(name)), name


def test_types_are_parsed_singly_where_cffi_keeps_them_elsewhere() -> None:
    with patch.object(ffi, "_parsed_types", None):
        assert parse_native_types.__wrapped__() == 0

"""wgpu's C types are found without being parsed one by one."""

import json
import subprocess
import sys
from unittest.mock import patch

import numpy as np
from wgpu.backends.wgpu_native._ffi import ffi

from gsgen.runtime.gpu.native_types import _ARRAYS, _CALLBACKS, _PLAIN, parse_native_types


def test_pointers_to_all_types_are_known_without_parsing() -> None:
    names = ffi.list_types()[0]
    assert parse_native_types() >= 400
    with patch.object(ffi._parser, "parse_type", side_effect=AssertionError("parsed")):
        assert ffi.sizeof(ffi.new("WGPULimits *")[0]) > 100
        pointers = {name: ffi.typeof(f"{name} *") for name in names}
    for name in np.random.default_rng(7).choice(sorted(pointers), 5, replace=False):
        assert pointers[name].item is ffi.typeof(str(name)), name


_FIRST_PICTURE = """
import json, sys
from cffi.cparser import Parser
from gsgen.runtime.gpu.native_types import parse_native_types
import numpy as np
from gsgen.runtime import Camera, Renderer, Scene, SplatData

parse_native_types()
parse, parsed = Parser.parse_type, []
Parser.parse_type = lambda self, text: (parsed.append(text), parse(self, text))[1]
rows = np.zeros((1, 10), np.float32)
rows[:, 3:5] = rows[:, [7, 9]] = 0.5
data = SplatData(rows, np.zeros((1, 3), np.float32), "rgb")
Renderer().render(Scene([data]), Camera.orbit((0, 0, 0), 4, width=16, height=16))
print(json.dumps(parsed))
"""


def test_a_first_picture_parses_no_type() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FIRST_PICTURE], capture_output=True, encoding="utf-8", timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == []


def test_types_that_are_parsed_together_are_those_that_cffi_parses() -> None:
    parse_native_types()
    for text in (*_PLAIN, *_ARRAYS, *_CALLBACKS):
        kept, is_function = ffi._parsed_types.pop(text)
        if is_function:
            assert ffi._typeof(text, consider_function_as_funcptr=True) is kept
        else:
            assert ffi.typeof(text) is kept


def test_types_are_parsed_singly_where_cffi_keeps_them_elsewhere() -> None:
    with patch.object(ffi, "_parsed_types", None):
        assert parse_native_types.__wrapped__() == 0

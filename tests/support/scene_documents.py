"""Scene files that are refused, with a part of the reason, and some that are read."""

from typing import Any

import numpy as np

A: dict[str, Any] = {"path": "a.npz"}

WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "empty": ({}, "the scene file has neither models nor meshes"),
    "version": ({"gsgen_scene": "2.0", "models": [A]}, r"gsgen_scene: is '2.0', expected 1.0"),
    "unknown": ({"models": [A], "mesh": []}, "unknown field 'mesh'\n.*'meshes'"),
    "nearest": (
        {"models": [A | {"opacty_scale": 1}]},
        r"models\[0\]: unknown field 'opacty_scale'\n.*'opacity_scale'",
    ),
    "no_path": ({"models": [{}]}, r"models\[0\]\.path: is missing, expected text"),
    "no_list": ({"models": A}, r"models: is .* expected a list"),
    "no_model": ({"models": [3]}, r"models\[0\]: is 3, expected an object or a path"),
    "opacity": (
        {"models": [A | {"opacity_scale": -1}]},
        r"opacity_scale: is -1, expected a finite number from 0",
    ),
    "text": ({"models": [A | {"opacity_scale": "1"}]}, "is '1', expected a number"),
    "nan": ({"models": [A | {"opacity_scale": float("nan")}]}, "is nan, expected a finite"),
    "degree": ({"models": [A | {"sh_degree": 4}]}, "expected a whole number from 0 to 3"),
    "word": (
        {"models": [A | {"antialias": "mipp"}]},
        r"models\[0\]\.antialias: unknown word 'mipp'\n.*'mip'",
    ),
    "both": (
        {"models": [A | {"transform": np.eye(4).tolist(), "scale": 2}]},
        "scale: excludes `transform`",
    ),
    "flat": ({"models": [A | {"scale": 0}]}, r"models\[0\]\.scale: the matrix is singular"),
    "shape": ({"models": [A | {"transform": [1, 2]}]}, "expected 4×4 numbers"),
    "ragged": ({"models": [A | {"transform": [[1], [2, 3]]}]}, "expected 4×4 numbers"),
    "huge": ({"models": [A | {"translate": [1, 2, 1e300]}]}, "numbers that are finite"),
    "rotate": ({"models": [A | {"rotate": [0, 0, 0, 0]}]}, "expected one with a length"),
    "axis": ({"models": [A | {"rotate": {"axis": [0, 0, 1]}}]}, 'expected {"axis"'),
    "turn": (
        {"models": [A | {"rotate": {"axes": [0, 0, 1], "degrees": 2}}]},
        r"rotate: unknown field 'axes'\n.*'axis'",
    ),
    "clip": ({"models": [A | {"clip": {"low": [1, 1, 1], "high": [0, 0, 0]}}]}, "with low <= high"),
    "inputs": ({"models": [A | {"inputs": {"time": "now"}}]}, r"inputs\.time: is 'now'"),
    "shading": (
        {"meshes": [A | {"shading": "phong"}]},
        r"meshes\[0\]\.shading: unknown word 'phong'",
    ),
    "background": ({"models": [A], "background": "puce"}, "background: 'puce' is not a colour"),
    "numbers": ({"models": [A], "background": [1, 2, 3]}, "background: '1,2,3' is not a colour"),
    "camera": ({"models": [A], "camera": {"fx": 1}}, r"camera: lacks view"),
    "width": ({"models": [A], "width": 0}, "width: is 0, expected a whole number from 1"),
    "fov": ({"models": [A], "fov": 180}, "fov: is 180 degrees, expected more than 0"),
    "up": ({"models": [A], "up": "y"}, "up: unknown word 'y'"),
}


READ: list[dict[str, Any]] = [
    {"models": ["a.npz"]},
    {
        "gsgen_scene": "1.3",
        "models": [A | {"transform": np.diag([2.0, -1, 1, 1]).tolist(), "blend": "alpha"}],
        "background": "#102030",
        "camera": "orbit",
        "up": "+z",
        "fov": 30,
        "width": 20,
        "height": 10,
    },
    {
        "models": [
            A
            | {
                "translate": [1, 2, 3],
                "rotate": {"axis": [1, 2, 3], "degrees": 40},
                "scale": [1, -2, 3],
                "clip": {"low": [0, 0, 0], "high": [1, 1, 1]},
                "inputs": {"time": 0.5, "pose": [[1, 2], [3, 4]], "is_on": True},
            },
            A | {"rotate": [3, 1, -2, 0.5], "scale": 0.3, "opacity_scale": 0},
        ],
        "background": [1, 0, 0.5],
        "camera": "look-at:0,0,-4,1,0,0",
    },
    {"models": [A], "background": "0.1,0.2,0.3,0", "camera": "orbit:30,20"},
]

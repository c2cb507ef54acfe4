"""Scene files that are refused, with a part of the reason, and some that are read."""

from typing import Any

import numpy as np

A: dict[str, Any] = {"path": "a.npz"}
NOTE: dict[str, Any] = {"position": [0, 1, 2], "text": "door"}
KEY: dict[str, Any] = {"at": 1, "value": 0.5}

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
    "segment_seconds": (
        {"models": [{"segments": [A], "capacity": 9}]},
        r"models\[0\]\.segments\[0\]\.seconds: is missing, expected seconds above 0",
    ),
    "segments_and_path": (
        {"models": [A | {"segments": [A | {"seconds": 1}], "capacity": 9}]},
        r"models\[0\]\.path: excludes `segments`",
    ),
    "no_capacity": (
        {"models": [{"segments": [A | {"seconds": 1}]}]},
        r"models\[0\]\.capacity: is the most Gaussians of `segments`",
    ),
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
    "mesh_opacity": (
        {"meshes": [A | {"opacity_scale": 1.5}]},
        r"meshes\[0\]\.opacity_scale: is 1.5, expected a finite number from 0 to 1",
    ),
    "animation": (
        {"meshes": [A | {"animation": -1}]},
        r"meshes\[0\]\.animation: is -1, expected text or a whole number from 0",
    ),
    "visible": ({"models": [A | {"visible": 1}]}, r"models\[0\]\.visible: is 1, expected true"),
    "annotation_text": (
        {"models": [A], "annotations": [{"position": [0, 0, 0]}]},
        r"annotations\[0\]\.text: is missing, expected text",
    ),
    "annotation_position": (
        {"models": [A], "annotations": [{"text": "door"}]},
        r"annotations\[0\]\.position: is missing, expected 3 numbers",
    ),
    "annotation_field": (
        {"models": [A], "annotations": [NOTE | {"positon": [0, 0, 0]}]},
        r"annotations\[0\]: unknown field 'positon'",
    ),
    "annotation_camera": (
        {"models": [A], "annotations": [NOTE | {"camera": "cameras.json"}]},
        r"annotations\[0\]\.camera: is 'cameras.json', expected orbit",
    ),
    "annotation_normal": (
        {"models": [A], "annotations": [NOTE | {"normal": [0, 1]}]},
        r"annotations\[0\]\.normal: is \[0, 1\], expected 3 numbers",
    ),
    "annotations": ({"models": [A], "annotations": NOTE}, r"annotations: is .* expected a list"),
    "sound_path": (
        {"models": [A], "sound": {"start": 1}},
        r"sound\.path: is missing, expected text",
    ),
    "sound_start": (
        {"models": [A], "sound": A | {"start": "now"}},
        r"sound\.start: is 'now', expected a number",
    ),
    "sound_field": (
        {"models": [A], "sound": A | {"caption": "a.vtt"}},
        r"sound: unknown field 'caption'\n.*'captions'",
    ),
    "background": ({"models": [A], "background": "puce"}, "background: 'puce' is not a colour"),
    "numbers": ({"models": [A], "background": [1, 2, 3]}, "background: '1,2,3' is not a colour"),
    "camera": ({"models": [A], "camera": {"fx": 1}}, r"camera: lacks view"),
    "width": ({"models": [A], "width": 0}, "width: is 0, expected a whole number from 1"),
    "fov": ({"models": [A], "fov": 180}, "fov: is 180 degrees, expected more than 0"),
    "up": ({"models": [A], "up": "y"}, "up: unknown word 'y'"),
    "key_order": (
        {"models": [A | {"inputs": {"time": {"keys": [KEY, KEY]}}}]},
        r"inputs\.time\.keys\[1\]\.at: is not later",
    ),
    "key_field": (
        {"models": [A | {"inputs": {"time": {"keys": [KEY | {"ease": 1}]}}}]},
        r"inputs\.time\.keys\[0\]: unknown field 'ease'",
    ),
    "key_without_time": (
        {"models": [A | {"inputs": {"time": {"keys": [{"value": 1}]}}}]},
        r"keys\[0\]\.at: is missing",
    ),
    "key_without_value": (
        {"models": [A | {"inputs": {"time": {"keys": [{"at": 1}]}}}]},
        r"keys\[0\]\.value: is missing",
    ),
    "key_easing": (
        {"models": [A], "camera": {"keys": [{"at": 0, "value": "orbit", "easing": "bounce"}]}},
        r"camera\.keys\[0\]\.easing: unknown word 'bounce'",
    ),
    "no_keys": ({"models": [A], "camera": {"keys": []}}, r"camera\.keys: has no key frame"),
    "key_camera": (
        {"models": [A], "camera": {"keys": [{"at": 0, "value": "cameras.json"}]}},
        r"camera\.keys\[0\]\.value: is 'cameras.json', expected orbit",
    ),
    "key_forms": (
        {
            "models": [A],
            "camera": {"keys": [{"at": 0, "value": "orbit"}, {"at": 1, "value": "orbit:1,2,3"}]},
        },
        r"camera\.keys\[1\]\.value: has another form",
    ),
    "timeline": ({"models": [A], "timeline": {"seconds": -1}}, r"timeline\.seconds: is -1"),
    "timeline_of_nothing": ({"models": [A], "timeline": {"fps": 25}}, r"timeline\.seconds: is 0"),
    "post_path": ({"models": [A], "posts": [{}]}, r"posts\[0\]\.path: is missing, expected text"),
    "post_field": (
        {"models": [A], "posts": ["a.onnx", {"path": "b.onnx", "input": {}}]},
        r"posts\[1\]: unknown field 'input'",
    ),
    "post_value": (
        {"models": [A], "posts": [{"path": "b.onnx", "inputs": {"style": "much"}}]},
        r"posts\[0\]\.inputs\.style: is 'much', expected numbers",
    ),
    "posts": ({"models": [A], "posts": "b.onnx"}, r"posts: is 'b.onnx', expected a list"),
    "timeline_loop": ({"models": [A], "timeline": {"seconds": 1, "loop": 1}}, "true or false"),
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
    {
        "models": [A | {"visible": False}],
        "meshes": [
            "a.glb",
            A | {"scale": 2, "shading": "unlit", "opacity_scale": 0.5, "animation": 1},
        ],
        "annotations": [NOTE, NOTE | {"normal": [0, 0, 1], "camera": "orbit:30,20"}],
    },
    {"meshes": [A | {"visible": False, "animation": "walk"}]},
    {
        "models": [
            A | {"inputs": {"time": {"keys": [{"at": 0.5, "value": 2, "easing": "hold"}, KEY]}}}
        ],
        "camera": {
            "keys": [{"at": 0, "value": "orbit:30,20,4"}, {"at": 3, "value": "orbit:90,2,1"}]
        },
        "timeline": {"fps": 30, "loop": True},
        "sound": {"path": "a.wav", "start": -0.5, "captions": "a.vtt"},
        "posts": ["b.onnx", {"path": "c.onnx", "inputs": {"style": {"keys": [KEY]}, "a": [1, 2]}}],
    },
]

"""The faults of viewers that the viewer test kit can tell apart, each with a hint."""

__all__ = ["VIEWER_FAULTS"]

from collections.abc import Mapping
from typing import Final

VIEWER_FAULTS: Final[Mapping[str, tuple[str, str]]] = {
    "rows": (
        "rows, the camera, the blending or the screen are read in another way, in every case",
        "A row is x y z, opacity, xx xy xz yy yz zz; the camera has +x right, +y down, +z forward; "
        "pixel centres are at halves; the background is black; sRGB colours are shown as they are.",
    ),
    "dilation": (
        "the dilation of projected Gaussians is left out",
        "Add 0.3 pixels² to both diagonal entries of the 2D covariance.",
    ),
    "order": (
        "Gaussians are blended unsorted, or from back to front with the formula of front to back",
        "Sort rows by depth in every frame, the nearest first, and blend them in that order.",
    ),
    "order-distance": (
        "Gaussians are sorted by their distance from the camera",
        "Sort by z in camera space.",
    ),
    "encoded-twice": (
        "sRGB colours are encoded as sRGB once more",
        "Encode only where color_space is linear; an sRGB texture or canvas encodes, too.",
    ),
    "sh-offset": (
        "the offset of SH colours is left out",
        "A colour is 0.5 plus the sum of its harmonics.",
    ),
    "sh-clamp": (
        "negative SH colours are blended",
        "Clamp each colour to at least 0 before blending.",
    ),
    "sh-order": (
        "SH coefficients are read channel by channel",
        "A row holds coefficient after coefficient, each with red, green and blue.",
    ),
    "sh-stride": (
        "rows of SH are read with the stride of degree 3",
        "The stride is 3 (degree + 1)²; the manifest declares the degree.",
    ),
    "sh-direction": (
        "SH are evaluated along the direction from the Gaussian to the camera",
        "The direction is the Gaussian's position minus the camera centre.",
    ),
    "float16": (
        "float16 outputs are read as float32",
        "The manifest declares the dtype of the outputs.",
    ),
    "fourth-channel": (
        "RGB of four channels is read with a stride of three",
        "Take the stride from the tensor's shape; the fourth channel has no meaning.",
    ),
    "color-space": (
        "linear colours are shown without encoding them",
        "Where color_space is linear, blend in linear light and encode the result as sRGB.",
    ),
    "antialias": (
        "the antialiasing of the manifest is ignored",
        "With antialias mip the opacity is multiplied by √(det Σ₂ / det Σ₂′).",
    ),
    "count": (
        "rows behind the count are drawn",
        "Draw the first count rows; the memory behind them may hold an earlier frame.",
    ),
    "stale-count": ("the count of the first frame is kept", "Read the count in every frame."),
    "stale-outputs": (
        "later frames show the outputs of the first one",
        "Run the model when an input changes; a replayed capture must read the new inputs.",
    ),
    "matrix-order": (
        "view, projection and image_view are fed transposed",
        "matrix_order column: the tensor holds the transpose; row: the matrix itself.",
    ),
    "matrix-order-ignored": (
        "view and projection are fed column-major although the manifest declares row",
        "Read space.matrix_order of the manifest; column is only its default.",
    ),
    "intrinsics": (
        "the principal point and the two focal lengths of the camera are ignored",
        "A point is at (fx x/z + cx, fy y/z + cy).",
    ),
    "projection-centre": (
        "the principal point is left out of the matrix that is fed as projection",
        "The matrix maps a point to where it is drawn: (fx x/z + cx, fy y/z + cy).",
    ),
    "viewport-order": ("viewport is fed as height and width", "The order is width, height."),
    "behind-camera": (
        "Gaussians behind the camera are drawn",
        "Do not draw a row whose centre is not in front of the near plane.",
    ),
    "time-range": (
        "time is fed from 0 to 1 although the manifest declares another range",
        "Feed time in the units of the input's range.",
    ),
    "default": (
        "inputs without a value are fed zeros",
        "Feed an input that has no value with the default of the manifest.",
    ),
    "weighted-sum": (
        "a weighted sum is drawn sorted by depth",
        "With blend wsr, draw cell by cell with the weights of weighted_sum.",
    ),
    "output-names": (
        "outputs are found by their order or shape",
        "The manifest names the tensor of each output.",
    ),
    "external-data": (
        "weights in a file beside the model are not loaded",
        "Load external data from the folder of the model.",
    ),
    **{
        f"role-{role}": (
            f"an input of role {role} keeps its default",
            f"Find the input by its role {role}, not by its name, and feed it in every frame.",
        )
        for role in (
            *("view", "projection", "camera_position", "viewport", "time", "frame_index"),
            *("pose", "root_rotation", "root_translation", "shape", "expression"),
            *("appearance_id", "control", "image", "image_view", "image_intrinsics"),
        )
    },
}
"""Fault id → what the viewer does wrong, and the hint that repairs it."""

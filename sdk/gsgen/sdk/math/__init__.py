"""Which torch functions for Gaussian generators survive ONNX export and graph capture?

Three hazards shape these functions. The exporter removes ``x + c`` for c below 1e-8, so an epsilon
that guards a norm disappears; a clamp under the square root stays. Boolean indexing gives shapes
that depend on data, which graph capture refuses; instead, values are multiplied by masks, and a
fixed number of rows is gathered. Some operators have no GPU kernel, or one that is wrong in replays
(GridSample, Round, NonZero, Scatter); arithmetic replaces them.
"""

__all__ = [
    "axis_angle_to_matrix", "camera_centre", "covariance_matrix", "covariance_upper",
    "frustum_mask", "hash_grid", "hex_plane", "inverse_3x3", "keep_rows", "matrix_to_quaternion",
    "quaternion_multiply", "quaternion_to_matrix",
    "rotate_covariance", "safe_normalize", "sample_plane", "sh_from_channel_major",
    "sh_from_coefficient_major", "sh_from_ply", "sh_from_rgb", "sh_of_degree", "skin",
    "skinning_transforms", "smpl_chain", "to_unit_cube", "top_rows", "transform_points", "tri_plane",
    "upper_triangle",
]  # fmt: skip

from gsgen.sdk.math.cameras import camera_centre, frustum_mask
from gsgen.sdk.math.compaction import keep_rows, top_rows
from gsgen.sdk.math.covariance import (
    covariance_matrix,
    covariance_upper,
    rotate_covariance,
    upper_triangle,
)
from gsgen.sdk.math.harmonics import (
    sh_from_channel_major,
    sh_from_coefficient_major,
    sh_from_ply,
    sh_from_rgb,
    sh_of_degree,
)
from gsgen.sdk.math.hash_grids import hash_grid
from gsgen.sdk.math.inverses import inverse_3x3
from gsgen.sdk.math.planes import hex_plane, sample_plane, to_unit_cube, tri_plane
from gsgen.sdk.math.rotations import (
    axis_angle_to_matrix,
    matrix_to_quaternion,
    quaternion_multiply,
    quaternion_to_matrix,
    safe_normalize,
    transform_points,
)
from gsgen.sdk.math.skinning import skin, skinning_transforms, smpl_chain

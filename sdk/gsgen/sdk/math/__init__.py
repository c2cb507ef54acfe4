"""The mathematics that generators share, in torch, in forms that survive export and capture.

Three hazards shape these functions. The exporter removes ``x + c`` for c below 1e-8, so an epsilon
that guards a norm disappears: a clamp under the square root stays. Boolean indexing and its kin
give shapes that depend on data, which graph capture refuses: masks multiply, and rows are moved by
gathers of a fixed number. And some operators have no kernel on a GPU, or one that is wrong when it
is replayed (GridSample, Round, NonZero, Scatter): there is arithmetic instead.

By subject: :mod:`~gsgen.sdk.math.rotations`, :mod:`~gsgen.sdk.math.covariance`,
:mod:`~gsgen.sdk.math.harmonics`, :mod:`~gsgen.sdk.math.cameras`,
:mod:`~gsgen.sdk.math.compaction`, :mod:`~gsgen.sdk.math.planes` and
:mod:`~gsgen.sdk.math.skinning`; all of it can be used from here.
"""

__all__ = [
    "axis_angle_to_matrix",
    "camera_centre",
    "covariance_matrix",
    "covariance_upper",
    "frustum_mask",
    "hex_plane",
    "keep_rows",
    "quaternion_multiply",
    "quaternion_to_matrix",
    "rotate_covariance",
    "safe_normalize",
    "sample_plane",
    "sh_from_channel_major",
    "sh_from_coefficient_major",
    "sh_from_ply",
    "sh_from_rgb",
    "sh_of_degree",
    "skin",
    "skinning_transforms",
    "to_unit_cube",
    "top_rows",
    "tri_plane",
    "upper_triangle",
]

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
from gsgen.sdk.math.planes import hex_plane, sample_plane, to_unit_cube, tri_plane
from gsgen.sdk.math.rotations import (
    axis_angle_to_matrix,
    quaternion_multiply,
    quaternion_to_matrix,
    safe_normalize,
)
from gsgen.sdk.math.skinning import skin, skinning_transforms

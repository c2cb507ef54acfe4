import pytest

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.fields.roles import (
    GENERATOR,
    MANIFEST_KINDS,
    POST_PROCESS,
    ROLES,
    matching_shape,
    role,
    shapes_of,
)
from gsgen.contract.spec.manifest import Input

SPECIFIED = {
    "view": ("float32", ((4, 4),)),
    "projection": ("float32", ((4, 4),)),
    "time": ("float32", ((1,),)),
    "frame_index": ("int32", ((1,),)),
    "camera_position": ("float32", ((3,),)),
    "viewport": ("float32", ((2,),)),
    "pose": ("float32", (("J", 3), ("J", 4))),
    "shape": ("float32", (("B",),)),
    "root_translation": ("float32", ((3,),)),
    "root_rotation": ("float32", ((3,), (3, 3))),
    "expression": ("float32", (("E",),)),
    "appearance_id": ("int32", ((1,),)),
    "control": ("float32", (("*",),)),
    "audio": ("float32", (("S",), ("W", "M"))),
    "condition": ("float32", (("*",),)),
    "image": ("float32", (("V", 3, "H", "W"),)),
    "image_view": ("float32", (("V", 4, 4),)),
    "image_intrinsics": ("float32", (("V", 3, 3),)),
}


@pytest.mark.parametrize("name", SPECIFIED)
def test_a_generator_role_has_the_dtype_and_shapes_of_the_contract(name):
    dtype, shapes = SPECIFIED[name]
    assert role(name).dtype[0] == dtype
    assert shapes_of(role(name), GENERATOR) == shapes


def test_a_generator_takes_the_roles_of_the_contract_and_no_others():
    generators = {role.name for role in ROLES.values() if "gaussian-generator" in role.kinds}
    assert generators == set(SPECIFIED)


def test_every_role_is_known_by_its_own_name_and_belongs_to_a_kind():
    for name, entry in ROLES.items():
        assert entry.name == name
        assert entry.summary.endswith(".")
        assert set(entry.kinds) <= set(MANIFEST_KINDS)
        assert entry.kinds


@pytest.mark.parametrize(
    ("name", "dims", "expected"),
    [
        ("view", (4, 4), (4, 4)),
        ("view", (16,), None),
        ("view", (1, 4, 4), None),
        ("pose", (24, 3), ("J", 3)),
        ("pose", (24, 4), ("J", 4)),
        ("pose", (24, 6), None),
        ("root_rotation", (3, 3), (3, 3)),
        ("root_rotation", (3,), (3,)),
        ("control", (), ("*",)),
        ("control", (2, 5, 7), ("*",)),
        ("image", (1, 3, "height", 64), (1, 3, "H", "W")),
        ("conditioning", (1, 768), (1, "D")),
    ],
)
def test_a_shape_matches_a_role_by_numbers_and_named_sizes(name, dims, expected):
    assert matching_shape(role(name), dims) == expected


def test_an_unknown_role_names_the_nearest():
    with pytest.raises(UnknownName) as caught:
        role("projektion")
    assert str(caught.value) == "unknown role 'projektion'\n  Did you mean 'projection'?"


def test_a_name_like_no_role_says_how_many_are_known():
    with pytest.raises(UnknownName) as caught:
        role("xyz")
    start = f"unknown role 'xyz'\n  {len(ROLES)} are known, such as "
    assert str(caught.value).startswith(start)
    assert set(str(caught.value).removeprefix(start).rstrip(".").split(", ")) <= set(ROLES)


def test_an_image_of_a_post_process_model_is_one_picture_of_three_or_four_channels():
    image = role("image")
    assert shapes_of(image, POST_PROCESS) == ((1, 3, "H", "W"), (1, 4, "H", "W"))
    assert matching_shape(image, (4, 3, 8, 8), GENERATOR) == ("V", 3, "H", "W")
    assert matching_shape(image, (4, 3, 8, 8), POST_PROCESS) is None


@pytest.mark.parametrize(
    ("name", "declared", "expected"),
    [
        ("image", None, True),
        ("image_view", None, True),
        ("image_intrinsics", None, True),
        ("condition", None, False),
        ("condition", "scene", True),
        ("shape", "scene", True),
        ("time", None, False),
        ("view", "frame", False),
    ],
)
def test_pictures_and_inputs_declared_so_belong_to_the_scene(name, declared, expected):
    assert Input(name="x", role=name, pass_=declared).is_of_scene is expected

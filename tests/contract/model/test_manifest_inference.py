import pytest

from gsgen.contract.model.graph import Graph, Tensor, read_graph, static_dims
from gsgen.contract.model.manifest_inference import infer_manifest
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import AppearanceOutput, CountOutput, GaussiansOutput, Input
from gsgen.contract.spec.manifest_io import dumps
from support.models.small_models import model, save

FULL = model("""
m (float[4,4] camera, float[1] t, float[24,3] pose, float[10] betas)
    => (float16[100,10] gaussian_f16, float16[100,48] color_sh, int32[1] num_points) {
    gaussian_f16 = Neg (camera)
    color_sh = Neg (t)
    num_points = Neg (pose)
}
""")


def graph_with(outputs=(), inputs=()):
    return Graph(
        inputs=tuple(inputs),
        outputs=tuple(outputs),
        nodes=(),
        initializers={},
        tensors={},
        functions=frozenset(),
    )


def test_names_and_shapes_give_a_manifest_that_can_be_written(tmp_path):
    graph = read_graph(open_model(save(tmp_path / "a.onnx", FULL)))
    candidate = infer_manifest(graph, "avatar")
    manifest = candidate.manifest
    assert manifest.name == "avatar"
    assert manifest.inputs == (
        Input(name="camera", role="view", default="zeros"),
        Input(name="t", role="time", range=(0.0, 1.0), default="zeros"),
        Input(name="pose", role="pose", shape=(24, 3), default="zeros"),
        Input(name="betas", role="shape", shape=(10,), range=(0.0, 1.0), default="zeros"),
    )
    assert manifest.outputs.gaussians == GaussiansOutput("gaussian_f16", 100, "float16")
    assert manifest.outputs.appearance == AppearanceOutput("color_sh", "sh", 3)
    assert manifest.outputs.count == CountOutput("num_points")
    assert candidate.manifest_guesses == (
        "input 'camera' is the view, by its name",
        "input 't' is the time, by its name",
        "input 't' has the range [0, 1]",
        "input 'pose' is the pose, by its name",
        "input 'betas' is the shape, by its name",
        "input 'betas' has the range [0, 1]",
        "output 'gaussian_f16' holds the packed Gaussians",
        "output 'color_sh' holds SH of degree 3, by its 48 channels",
        "output 'num_points' is the number of live rows",
        "space: -y up, arbitrary unit, column matrix order (the usual for 3DGS)",
        "bounds: unknown, add the box that holds the Gaussians",
    )
    assert dumps(manifest)


def test_unrecognised_model_is_reported():
    candidate = infer_manifest(graph_with(inputs=[Tensor("noise", "float32", (3,))]), "a")
    assert candidate.manifest.inputs == ()
    assert candidate.manifest_guesses[:4] == (
        "input 'noise' has no recognisable role: add it by hand",
        "no output is named like packed Gaussians or is the only one ending in 10",
        "no output is named like an appearance",
        "no output is named like a row count",
    )
    assert dumps(candidate.manifest)


@pytest.mark.parametrize("name", ["overview", "view2", "my_time", "timeline", "posed"])
def test_parts_of_a_name_are_no_sign_of_a_role(name):
    candidate = infer_manifest(graph_with(inputs=[Tensor(name, "float32", (4, 4))]), "a")
    assert candidate.manifest.inputs == ()


def test_upper_and_lower_case_are_the_same():
    candidate = infer_manifest(graph_with(inputs=[Tensor("ViewMatrix", "float32", (4, 4))]), "a")
    assert [i.role for i in candidate.manifest.inputs] == ["view"]


def rows(name, *dims):
    return Tensor(name, "float32", dims)


@pytest.mark.parametrize(
    ("outputs", "actual"),
    [
        ([rows("splats", 7, 10)], GaussiansOutput("splats", 7)),
        ([rows("splats", "N", 10)], GaussiansOutput("splats", 1)),
        ([rows("a", 7, 10), rows("b", 7, 10)], None),
        ([rows("a", 7, 10), rows("gaussians", 7, 9)], GaussiansOutput("gaussians", 7)),
        ([Tensor("gaussians", None, None)], GaussiansOutput("gaussians", 1)),
        ([rows("a", 7, 11)], None),
        ([rows("a")], None),
    ],
)
def test_gaussians_are_the_output_of_that_name_or_the_only_one_that_ends_in_ten(outputs, actual):
    assert infer_manifest(graph_with(outputs), "a").manifest.outputs.gaussians == actual


@pytest.mark.parametrize(
    ("dims", "actual"),
    [
        ((7, 3), AppearanceOutput("color", "rgb")),
        ((7, 4), AppearanceOutput("color", "rgb")),
        ((7, 12), AppearanceOutput("color", "sh", 1)),
        ((7, 27), AppearanceOutput("color", "sh", 2)),
        ((7, "C"), AppearanceOutput("color", "rgb")),
    ],
)
def test_appearance_is_inferred_from_its_channels(dims, actual):
    outputs = [Tensor("color", "float32", dims)]
    assert infer_manifest(graph_with(outputs), "a").manifest.outputs.appearance == actual


@pytest.mark.parametrize(
    ("dims", "static"),
    [
        ((2, 3), (2, 3)),
        ((), ()),
        ((2, "N"), None),
        ((2, None), None),
        ((2, 0), None),
        ((2, -1), None),
        (None, None),
    ],
)
def test_dimensions_are_static_if_all_are_positive_numbers(dims, static):
    assert static_dims(Tensor("a", "float32", dims)) == static

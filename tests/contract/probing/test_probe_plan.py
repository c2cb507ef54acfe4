from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probe_plan import make_plan
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import ImageOutput, Input, PostProcessManifest, PostProcessOutputs
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from support.models.small_models import good_rows, manifest_of, model, moving, save


@pytest.fixture
def subject_of(tmp_path):
    def read(proto, manifest):
        opened = open_model(save(tmp_path / "a.onnx", proto, manifest))
        return inspect_model(opened, load_target("core"), Limits())

    return read


@pytest.fixture
def subject(subject_of):
    return subject_of(moving(good_rows(4)), manifest_of(4))


def test_values_need_nothing_but_the_default_probes(subject):
    plan = make_plan(subject, Level.VALUES)
    assert len(plan.probes) == plan.values == 9
    assert (plan.repeated, plan.revisited_pair, plan.variants) == (None, None, {})


def test_behaviour_repeats_a_probe_revisits_it_and_varies_each_role(subject):
    plan = make_plan(subject, Level.BEHAVIOUR)
    assert plan.values == 9
    assert plan.repeated == (9, 10)
    assert plan.revisited_pair == (1, 9)
    assert plan.probes[1] is plan.probes[9] is plan.probes[10]
    assert plan.variants == {"time": (1, (11, 12))}
    assert not any(probe.extra for probe in plan.probes[:13])
    assert all(probe.extra for probe in plan.probes[13:])
    for index in (11, 12):
        changed = plan.probes[index].inputs["time"] != plan.probes[1].inputs["time"]
        assert changed.all()


def test_a_model_without_inputs_is_run_thrice_and_once_unoptimised(subject_of):
    text = "m () => (float[1] y) <float[1] w = {1}> { y = Neg (w) }"
    manifest = replace(manifest_of(1), inputs=())
    plan = make_plan(subject_of(model(text), manifest), Level.BEHAVIOUR)
    assert (len(plan.probes), plan.values) == (4, 1)
    assert not plan.probes[plan.trials["plain"][0]].optimise
    assert plan.repeated == (1, 2)
    assert (plan.revisited_pair, plan.variants) == (None, {})


def test_another_seed_gives_other_probes(subject_of):
    text = "m (float[5] betas) => (float[5] y) { y = Neg (betas) }"
    inputs = (Input(name="betas", role="shape", shape=(5,), range=(-1.0, 1.0)),)
    subject = subject_of(model(text), replace(manifest_of(1), inputs=inputs))
    a, b = (make_plan(subject, Level.VALUES, seed).probes[1] for seed in (0, 1))
    assert (a.inputs["betas"] != b.inputs["betas"]).all()


@pytest.mark.parametrize(
    ("rows", "count", "variants"), [(1000, 8, 2), (4_000_000, 5, 1), (10**9, 3, 1)]
)
def test_large_outputs_are_probed_less_often(subject_of, rows, count, variants):
    text = f"m (float[1] time) => (float[{rows}, 10] gaussians, float[{rows}, 3] color) "
    text += "{ gaussians = Neg (time) color = Neg (time) }"
    subject = subject_of(model(text), manifest_of(rows))
    assert make_plan(subject, Level.VALUES).values == 1 + count
    assert len(make_plan(subject, Level.BEHAVIOUR).variants["time"][1]) == variants


def enhancer(shape):
    return PostProcessManifest(
        name="enhancer",
        inputs=(Input(name="image", role="image", shape=shape),),
        outputs=PostProcessOutputs(ImageOutput("better")),
    )


@pytest.mark.parametrize(
    ("dims", "declared", "probed"),
    [
        ("[1, 3, H, W]", None, (1, 3, 64, 64)),
        ("[1, 3, H, W]", (1, 3, 32, 48), (1, 3, 32, 48)),
        ("[1, 3, 16, W]", (1, 3, 32, 48), (1, 3, 16, 48)),
        ("[1, 3, 8, 8]", None, (1, 3, 8, 8)),
        ("", (1, 3, 32, 48), (1, 3, 32, 48)),
    ],
)
def test_sizes_that_the_graph_leaves_open_come_from_the_manifest(
    subject_of, dims, declared, probed
):
    proto = model(f"m (float{dims} image) => (float{dims} better) {{ better = Neg (image) }}")
    if not dims:
        proto.graph.input[0].type.tensor_type.ClearField("shape")
    plan = make_plan(subject_of(proto, enhancer(declared)), Level.VALUES)
    shapes = {probe.inputs["image"].shape for probe in plan.probes[: plan.values]}
    assert shapes == {probed}


@pytest.mark.parametrize(
    ("dims", "declared", "odd"),
    [
        ("[1, 3, H, W]", None, [(1, 3, 37, 53)]),
        ("[1, 3, N, N]", None, [(1, 3, 53, 53)]),
        ("[1, 3, 16, W]", None, [(1, 3, 16, 53)]),
        ("[1, 3, H, W]", (1, 3, 32, 48), []),
        ("[1, 3, 8, 8]", None, []),
    ],
)
@pytest.mark.parametrize("level", [Level.VALUES, Level.BEHAVIOUR])
def test_models_of_open_size_run_once_at_an_odd_size(subject_of, dims, declared, odd, level):
    proto = model(f"m (float{dims} image) => (float{dims} better) {{ better = Neg (image) }}")
    plan = make_plan(subject_of(proto, enhancer(declared)), level)
    assert [plan.probes[index].inputs["image"].shape for index in plan.trials["sizes"]] == odd
    assert plan.trials["sizes"] == tuple(range(plan.values, plan.values + len(odd)))
    assert all(probe.inputs["image"].dtype == np.float32 for probe in plan.probes)

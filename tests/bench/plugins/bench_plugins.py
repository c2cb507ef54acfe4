"""What a frame of the reference plugins costs, against eager torch of the same module.

One thread for both. The floor is the time in which the frame's outputs can be written and the
multiplications of its networks be done, both measured in the same run. Run by ``make bench``.
"""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from gsgen.contract.probing.picture_probes import synthetic_pictures
from gsgen.contract.spec.geometry import look_at
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.anchors.anchor_checkpoint import read_anchors
from gsgen.reference_plugins.anchors.cell_checkpoint import read_cells
from gsgen.reference_plugins.anchors.duplex_gs import DuplexGS
from gsgen.reference_plugins.anchors.octree_gs import Levels, OctreeGS
from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS
from gsgen.reference_plugins.deformation.deformable_3dgs import Deformable3DGS
from gsgen.reference_plugins.deformation.deformation_checkpoint import read_deformation
from gsgen.reference_plugins.deformation.hexplane_4dgs import HexPlane4DGS
from gsgen.reference_plugins.deformation.hexplane_checkpoint import read_hexplanes
from gsgen.reference_plugins.deformation.sc_gs import ScGs
from gsgen.reference_plugins.deformation.sc_gs_checkpoint import read_sc_gs
from gsgen.reference_plugins.feed_forward.lgm import Lgm
from gsgen.reference_plugins.feed_forward.lgm_checkpoint import read_lgm
from gsgen.reference_plugins.feed_forward.splatter_image import SplatterImage
from gsgen.reference_plugins.feed_forward.splatter_image_checkpoint import read_splatter_image
from gsgen.reference_plugins.heads.gaussian_avatars import GaussianAvatars
from gsgen.reference_plugins.heads.gaussian_avatars_checkpoint import read_gaussian_avatars
from gsgen.reference_plugins.people.gart import Gart
from gsgen.reference_plugins.people.gart_checkpoint import read_gart
from gsgen.reference_plugins.people.gauhuman import GauHuman
from gsgen.reference_plugins.people.gauhuman_checkpoint import read_gauhuman
from gsgen.reference_plugins.people.lhm import LHM
from gsgen.reference_plugins.people.lhm_checkpoint import read_lhm
from gsgen.reference_plugins.people.r3_avatar import R3Avatar
from gsgen.reference_plugins.people.r3_avatar_checkpoint import read_r3
from gsgen.reference_plugins.spacetime.ex4dgs import Ex4DGS
from gsgen.reference_plugins.spacetime.ex4dgs_checkpoint import read_ex4dgs
from gsgen.reference_plugins.spacetime.rotor_4dgs import Rotor4DGS
from gsgen.reference_plugins.spacetime.rotor_checkpoint import read_rotor
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import read_spacetime
from gsgen.reference_plugins.spacetime.spacetime_gaussians import SpacetimeGaussians
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    PersonOptions,
    write_deformable,
    write_duplex,
    write_ex4dgs,
    write_gart,
    write_gauhuman,
    write_gaussian_avatar,
    write_hexplane,
    write_lgm,
    write_lhm,
    write_octree,
    write_r3,
    write_rotor,
    write_sc_gs,
    write_scaffold,
    write_spacetime,
    write_splatter_image,
)
from gsgen.sdk import GaussianGenerator, export
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from support.measures import print_figure, process_seconds
from support.models import needed_tensors

# Half of the tables, and the graph and small tables as they are.
BAR, SIZE_BAR, HALF_BAR = 1.0, 1.05, 0.53
ROUNDS = 7


def measure(
    generator: GaussianGenerator,
    feeds: dict[str, np.ndarray],
    folder: Path,
    eager: GaussianGenerator | None = None,
) -> None:
    """Export, run both by turns, print, and hold the ratio against the bar.

    ``eager`` is the module in torch's fastest form, with all constants computed beforehand.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        _measure(generator, feeds, folder, eager or generator)
    finally:
        torch.set_num_threads(threads)


def _measure(
    generator: GaussianGenerator,
    feeds: dict[str, np.ndarray],
    folder: Path,
    original: GaussianGenerator,
) -> None:
    path = folder / "model.onnx"
    export(generator, path, settings=Settings(level=Level.STATIC))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)
    tensors = [torch.from_numpy(value) for value in feeds.values()]
    with torch.no_grad():
        rows = original(*tensors).position.shape[0]
        packed = PackedGenerator(original, Packed(torch.float32, rows))
        packed(*tensors)
        session.run(None, feeds)
        eager, graph = [], []
        for _ in range(ROUNDS):  # by turns, so that both meet the same machine
            eager.append(process_seconds(lambda: packed(*tensors)))
            graph.append(process_seconds(lambda: session.run(None, feeds)))
    outputs = session.run(None, feeds)
    ratio, nanoseconds_per_row = min(graph) / min(eager), 1e9 / rows
    min_seconds = _floor(path, sum(value.nbytes for value in outputs))
    size, weights = path.stat().st_size, _weights(path)
    print_figure(
        f"{rows:,} Gaussians: graph {1e3 * min(graph):.1f} ms, eager {1e3 * min(eager):.1f} ms, "
    )
    print_figure(
        f"ratio {ratio:.2f} (bar {BAR}); {min(graph) * nanoseconds_per_row:.0f} ns a Gaussian, "
    )
    print_figure(
        f"{min(graph) / min_seconds:.1f} × the floor of {min_seconds * nanoseconds_per_row:.0f} ns"
    )
    print_figure(f"file {size / 1e6:.1f} MB, {size / weights:.3f} × its weights (bar 1.05)")
    assert ratio <= BAR
    assert size <= 1.05 * weights


def _weights(path: Path) -> int:
    graph = onnx.load(path).graph
    return sum(len(tensor.raw_data) for tensor in graph.initializer)


def _floor(path: Path, written: int) -> float:
    """Return the time of writing the outputs and of the graph's large multiplications."""
    model = onnx.shape_inference.infer_shapes(onnx.load(path), data_prop=True)
    shapes = {tensor.name: list(tensor.dims) for tensor in model.graph.initializer}
    for value in model.graph.value_info:
        dims = value.type.tensor_type.shape.dim
        shapes.setdefault(value.name, [dim.dim_value for dim in dims])
    target = np.empty(written // 4, np.float32)
    total = min(process_seconds(lambda: target.fill(1)) for _ in range(ROUNDS))
    for node in model.graph.node:
        if node.op_type not in ("MatMul", "Gemm"):
            continue
        a, b = (shapes.get(name) for name in node.input[:2])
        if not a or not b or len(a) != 2 or a[0] < 1000:
            continue
        left, right = torch.rand(a), torch.rand(b)
        out = torch.empty(a[0], b[1])
        total += min(
            process_seconds(lambda x=left, y=right, z=out: torch.mm(x, y, out=z)) for _ in range(3)
        )
    return total


def view() -> np.ndarray:
    matrix = look_at(np.array([3.0, -1.0, 2.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return np.ascontiguousarray(matrix.T, np.float32)


def bench_scaffold_gs(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=100_000, per_anchor=10, width=32, is_single_file=True)
    read = read_anchors(write_scaffold(tmp_path / "run", options))
    measure(ScaffoldGS(read.cloud, read.nets), {"camera": view()}, tmp_path)


def bench_octree_gs(tmp_path: Path) -> None:
    options = AnchorOptions(anchors=20_000, per_anchor=10, width=32, is_single_file=True)
    read = read_anchors(write_octree(tmp_path / "run", options), octree=True)
    generator = OctreeGS(read.cloud, read.nets, Levels.of(read))
    measure(generator, {"camera": view()}, tmp_path)


def bench_hexplane_4dgs(tmp_path: Path) -> None:
    options = HexPlaneOptions(
        count=60_000, channels=32, resolution=(64, 64, 64, 100), multires=(1, 2), width=64
    )
    read = read_hexplanes(write_hexplane(tmp_path / "run", options))
    generator = HexPlane4DGS(read.canonical, read.nets, read.flags)
    baked = HexPlane4DGS(read.canonical, read.nets, read.flags, bake="always")
    measure(generator, {"time": np.array([0.37], np.float32)}, tmp_path, baked)


FRAME = np.array([0.37], np.float32)


def bench_rotor_4dgs(tmp_path: Path) -> None:
    read = read_rotor(write_rotor(tmp_path / "run", count=60_000))
    measure(Rotor4DGS(read.splats, (0.0, 1.0)), {"time": FRAME}, tmp_path)


def bench_spacetime_gaussians(tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path / "run", count=100_000))
    measure(SpacetimeGaussians(read.splats), {"time": FRAME}, tmp_path)


def bench_ex4dgs(tmp_path: Path) -> None:
    read = read_ex4dgs(write_ex4dgs(tmp_path / "run", count=100_000, frames=300))
    measure(Ex4DGS(read), {"time": FRAME}, tmp_path)


def bench_sc_gs(tmp_path: Path) -> None:
    read = read_sc_gs(write_control_nodes(tmp_path / "run", count=60_000))
    measure(ScGs(read), {"time": FRAME}, tmp_path)


def bench_gaussian_avatars(tmp_path: Path) -> None:
    read = read_gaussian_avatars(write_gaussian_avatar(tmp_path / "run", count=60_000, rings=50))
    rng = np.random.default_rng(0)
    feeds = {
        "pose": rng.normal(0, 0.2, (5, 3)).astype(np.float32),
        "expression": rng.normal(size=10).astype(np.float32),
        "root_translation": np.zeros(3, np.float32),
    }
    measure(GaussianAvatars(read), feeds, tmp_path)


def bench_gart(tmp_path: Path) -> None:
    person = PersonOptions(count=40_000, vertices=6_890, degree=1, width=256)
    read = read_gart(write_gart(tmp_path / "run", person, resolution=64))
    rng = np.random.default_rng(0)
    feeds = {
        "pose": rng.normal(0, 0.3, (24, 3)).astype(np.float32),
        "root_translation": np.zeros(3, np.float32),
        "camera": view(),
    }
    measure(Gart(read), feeds, tmp_path)


def bench_lgm(tmp_path: Path) -> None:
    sizes = {"down": (32, 64, 128, 128), "up": (128, 64, 32)}
    read = read_lgm(write_lgm(tmp_path / "run", **sizes))
    measure(Lgm(read, 64), {"image": pictures((4, 3, 64, 64))}, tmp_path)


def bench_splatter_image(tmp_path: Path) -> None:
    folder = write_splatter_image(tmp_path / "run", side=64, width=32, blocks=2)
    generator = SplatterImage(read_splatter_image(folder))
    shape = next(declared.shape for declared in generator.inputs if declared.role == "image")
    views = np.eye(4, dtype=np.float32)[None]
    feeds = {"image": pictures(shape), "image_view": views}
    measure(generator, {name: feeds[name] for name in named(generator)}, tmp_path)


def pictures(shape: tuple[int, ...] | None) -> np.ndarray:
    assert shape is not None
    return synthetic_pictures(shape, np.random.default_rng(0)).astype(np.float32)


def named(generator: GaussianGenerator) -> list[str]:
    return [declared.name for declared in generator.inputs]


def write_control_nodes(folder: Path, count: int) -> Path:
    """Write an SC-GS checkpoint of the published sizes: 512 nodes in 11 dimensions."""
    return write_sc_gs(folder, count=count, nodes=512, width=256, options={"hyper_dim": 8})


def newer_plugins(folder: Path) -> Iterator[tuple[str, GaussianGenerator, int]]:
    """Yield generators of four further families, at sizes where weights outweigh the graph."""
    rotor = read_rotor(write_rotor(folder / "rotor", count=5_000)).splats
    yield "rotor-4dgs", Rotor4DGS(rotor, (0.0, 1.0)), needed_tensors.of_splats(rotor)
    moving = read_spacetime(write_spacetime(folder / "spacetime", count=20_000)).splats
    yield "spacetime", SpacetimeGaussians(moving), needed_tensors.of_splats(moving)
    nodes = read_sc_gs(write_control_nodes(folder / "nodes", count=10_000))
    yield "sc-gs", ScGs(nodes), needed_tensors.of_nodes(nodes)
    head = read_gaussian_avatars(write_gaussian_avatar(folder / "head", count=14_000, rings=50))
    yield "avatars", GaussianAvatars(head), needed_tensors.of_head(head)


def bench_sizes(tmp_path: Path) -> None:
    """Print bytes of files over bytes of the tensors that models need; nothing is timed."""
    for name, generator, minimum_bytes in chain(sized(tmp_path), newer_plugins(tmp_path)):
        sizes = []
        for dtype in ("float32", "float16"):
            path = tmp_path / f"{dtype}.onnx"
            settings = Settings(level=Level.STATIC)
            export(generator, path, dtype=dtype, settings=settings)  # type: ignore[arg-type]
            sizes.append(path.stat().st_size)
        full, half = sizes
        print_figure(
            f"{name:14} {full / 1e6:7.2f} MB, {full / minimum_bytes:.3f} × the tensors needed; "
        )
        print_figure(f"{'':14} {half / 1e6:7.2f} MB in float16, {half / full:.3f} × that")
        assert full <= SIZE_BAR * minimum_bytes, name
        assert half <= HALF_BAR * full, name


def sized(folder: Path) -> Iterator[tuple[str, GaussianGenerator, int]]:
    """Yield generators of every family, at sizes where weights outweigh the graph."""
    anchors = AnchorOptions(anchors=10_000, per_anchor=10, width=32, is_single_file=True)
    scaffold = read_anchors(write_scaffold(folder / "scaffold", anchors))
    yield (
        "scaffold-gs",
        ScaffoldGS(scaffold.cloud, scaffold.nets),
        needed_tensors.of_anchors(scaffold),
    )
    octree = read_anchors(write_octree(folder / "octree", anchors, mode="progressive"), octree=True)
    generator = OctreeGS(octree.cloud, octree.nets, Levels.of(octree))
    yield "octree-gs", generator, needed_tensors.of_anchors(octree)
    cells = read_cells(write_duplex(folder / "duplex", anchors))
    duplex = DuplexGS(cells, Levels.of(cells.anchors))
    yield "duplex-gs", duplex, needed_tensors.of_cells(cells, visibility=False)
    for count in (10_000, 40_000):
        options = HexPlaneOptions(
            count=count, channels=32, resolution=(64, 64, 64, 50), multires=(1,), width=64
        )
        plane = read_hexplanes(write_hexplane(folder / f"hexplane{count}", options))
        moving = HexPlane4DGS(plane.canonical, plane.nets, plane.flags)
        yield f"4dgs {count:,}", moving, needed_tensors.of_hexplane(plane)
    deformed = read_deformation(write_deformable(folder / "deform", count=10_000))
    warped = Deformable3DGS(deformed.canonical, deformed.net)
    yield "deformable", warped, needed_tensors.of_deformation(deformed)
    people = PersonOptions(count=20_000, vertices=6_890, nets=True, width=128)
    person = read_gauhuman(write_gauhuman(folder / "gauhuman", people))
    minimum_bytes = needed_tensors.of_gauhuman(person.canonical, person.body, person.nets)
    yield "gauhuman", GauHuman(person.canonical, person.body, person.nets), minimum_bytes
    drawn = read_lhm(write_lhm(folder / "lhm", PersonOptions(count=20_000, vertices=10_475)))
    yield "lhm", LHM(drawn), needed_tensors.of_lhm(drawn)
    people = PersonOptions(
        count=10_000, vertices=6_890, nets=True, channels=16, resolution=(64, 64, 64, 50)
    )
    person3 = read_r3(write_r3(folder / "r3", people))
    actor = R3Avatar(person3, range(20))
    yield "r3-avatar", actor, needed_tensors.of_r3(person3, actor.near.shape[0])

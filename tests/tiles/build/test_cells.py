"""Morton codes, cells and the choice of cells, beside plain Python."""

import numpy as np
import pytest

from gsgen.formats.merging.levels import choose_cells, merge_level, stored_degree
from gsgen.formats.merging.morton import DEPTH, Cube, cell_codes, morton_codes, separation_depths
from support.tiles.tile_scenes import mixture


def code_oracle(position, cube):
    code = 0
    cells = [
        min(max(int((float(x) - low) / cube.side * 2**DEPTH // 1), 0), 2**DEPTH - 1)
        for x, low in zip(position, cube.low, strict=True)
    ]
    for bit in range(DEPTH):
        for axis in range(3):
            code |= (cells[axis] >> bit & 1) << (3 * bit + axis)
    return code


@pytest.mark.parametrize("origin", [0.0, -1e6, 5e8])
def test_codes_are_interleaved_bits(origin):
    rng = np.random.default_rng(1)
    position = (rng.normal(size=(50, 3)) * 7 + origin).astype(np.float32)
    double_precision = position.astype(np.float64)
    cube = Cube.enclosing(double_precision.min(axis=0), double_precision.max(axis=0))
    codes = morton_codes(position, cube)
    assert codes.tolist() == [code_oracle(row, cube) for row in position]
    for row, code in zip(double_precision, codes.tolist(), strict=True):
        for depth in (0, 3, 9):
            cell = cube.cell(depth, code >> 3 * (DEPTH - depth))
            low = np.asarray(cell.low) - 1e-9 * cube.side
            assert ((row >= low) & (row <= low + cell.side * (1 + 1e-6))).all()


def test_a_scene_of_one_point_has_a_cube():
    point = np.array([3.0, 4.0, 5.0])
    cube = Cube.enclosing(point, point)
    assert cube.side > 0
    assert morton_codes(point[None], cube)[0] < 1 << 63


@pytest.mark.parametrize("seed", range(4))
def test_rows_separate_where_their_prefixes_differ(seed):
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 64, 300)
    codes = np.sort(rng.integers(0, 1 << 63, 300, dtype=np.uint64) >> bits.astype(np.uint64))
    codes = np.sort(np.concatenate([codes, codes[:20], [0, (1 << 63) - 1]]).astype(np.uint64))
    expected = []
    for before, after in zip(codes[:-1].tolist(), codes[1:].tolist(), strict=True):
        depths = [
            depth
            for depth in range(DEPTH + 1)
            if before >> 3 * (DEPTH - depth) != after >> 3 * (DEPTH - depth)
        ]
        expected.append(depths[0] if depths else DEPTH + 1)
    assert separation_depths(codes).tolist() == expected


@pytest.mark.parametrize("depth", [0, 2])
@pytest.mark.parametrize("target", [1, 30, 100, 10_000])
def test_the_chosen_cells_are_those_nearest_to_the_target(depth, target):
    rng = np.random.default_rng(7)
    prefix = np.uint64(5) << np.uint64(3 * (DEPTH - depth)) if depth else np.uint64(0)
    codes = np.sort(rng.integers(0, 1 << 3 * (DEPTH - depth), 400, dtype=np.uint64)) | prefix
    chosen, starts = choose_cells(codes, depth, target)
    counts = [len(np.unique(cell_codes(codes, d))) for d in range(depth, DEPTH + 1)]
    errors = [abs(np.log(count / target)) for count in counts]
    assert errors[chosen - depth] == pytest.approx(min(errors))
    cells = cell_codes(codes, chosen)
    assert starts.tolist() == [i for i in range(len(cells)) if i == 0 or cells[i] != cells[i - 1]]


def test_a_level_has_about_a_quarter_and_stays_in_its_cells():
    members = mixture(np.random.default_rng(2), 4000)
    level = merge_level(members, 0, 1 << 20)
    assert 1 / 12 < len(level.mixture) / len(members) < 3 / 4
    own = np.unique(cell_codes(members.code, level.depth))
    np.testing.assert_array_equal(np.unique(cell_codes(level.mixture.code, level.depth)), own)


def clusters_oracle(members, depth, count):
    """The members of each splat of a level: the largest alone while there is room."""
    cells = {}
    for row, code in enumerate(members.code.tolist()):
        cells.setdefault(code >> 3 * (DEPTH - depth), set()).add(row)
    alone = []
    for row in sorted(range(len(members)), key=lambda row: (-members.mass[row], row)):
        cell = cells[members.code[row].item() >> 3 * (DEPTH - depth)]
        if len(alone) + len([cell for cell in cells.values() if cell]) + (len(cell) > 1) > count:
            break
        alone.append(row)
        cell.remove(row)
    return alone, [sorted(cell) for cell in cells.values() if cell]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("spread", [0.1, 4.0])
def test_the_largest_splats_stay_where_there_is_room(seed, spread):
    members = mixture(np.random.default_rng(seed), 1600)
    members.scale[:] **= spread  # at 4, some splats have most of the mass
    level = merge_level(members, 0, 1 << 20)
    alone, clusters = clusters_oracle(members, level.depth, 400)
    assert len(level.mixture) == len(alone) + len(clusters)
    assert len(alone) == 0 or len(level.mixture) == 400
    retained = np.isin(members.mean[:, 0], level.mixture.mean[:, 0])
    assert retained[alone].all()
    assert (np.diff(level.mixture.code.astype(object)) >= 0).all()


@pytest.mark.parametrize(("large_mass", "finer_level"), [(1.0, True), (50.0, False)])
def test_coarser_cells_leave_room_for_splats_that_hold_most_of_the_mass(large_mass, finer_level):
    members = mixture(np.random.default_rng(1), 2000)
    members.code[:] = np.sort(members.code >> np.uint64(3) & ~np.uint64(7))
    members.scale[:] = 1
    members.scale[::20] = large_mass
    target = 0.9 * len(np.unique(cell_codes(members.code, 4)))
    nearest, starts = choose_cells(members.code, 0, target)
    assert len(starts) > target
    level = merge_level(members, 0, int(target))
    assert level.depth == nearest - (not finer_level)
    assert finer_level or len(level.mixture) == int(target)


def test_mass_is_conserved_beside_retained_splats():
    members = mixture(np.random.default_rng(3), 2000)
    members.opacity[:] *= 1e-4
    level = merge_level(members, 0, 1 << 20)
    np.testing.assert_allclose(level.mixture.mass.sum(), members.mass.sum(), rtol=1e-9)


def test_a_level_is_not_larger_than_a_leaf_may_be():
    members = mixture(np.random.default_rng(2), 4000)
    assert len(merge_level(members, 0, 100).mixture) < 300


def test_harmonics_without_energy_are_not_stored():
    members = mixture(np.random.default_rng(2), 50)
    assert stored_degree(members) == 1
    members.sh[:, 1:] *= 0.03
    assert stored_degree(members) == 0
    members.sh[:] = 0  # nothing at all is less than nothing
    assert stored_degree(members) in (0, 1)

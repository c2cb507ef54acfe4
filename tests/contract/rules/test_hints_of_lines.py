"""Hints end on the line of torch that undoes the diagnosed mistake, or hides few broken rows."""

from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.contract.causes.pose_readings import _line_of_axes, _turned_axes, declared_rotation
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.finding import line_hint
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

LINES = {
    "count_above_capacity": "num_points = num_points.clamp(0, 5)",
    "visibility_is_logits": "rows[:, 3] = rows[:, 3].sigmoid()",
    "negative_visibility": "rows[:, 3] = rows[:, 3].clamp(0, 1)",
    "sh_rest_before_constant": "rows = torch.cat([rows[:, 45:], rows[:, :45]], 1)",
    "rows_sorted_alone": "rows = rows[torch.argsort(torch.argsort(gaussians[:, 1]))]",
    "premultiplied_colors": "rows[:, :3] = rows[:, :3] / gaussians[:, 3:4].clamp(1 / 255)",
    "positions_in_millimetres": "rows[:, 4:] = rows[:, 4:] * 1000 * 1000",
    "indefinite_covariance": "rows[[2]] = 0",
    "zero_covariance": "rows[[2]] = 0",
}


@pytest.mark.parametrize(("name", "line"), LINES.items())
def test_a_hint_has_the_line_that_undoes_the_mistake(name: str, line: str, tmp_path: Path) -> None:
    path = find(name).write(tmp_path)
    (finding,) = validate(path, Settings(level=Level.VALUES)).findings
    assert line_hint(line).lower() in finding.hint.lower()


def test_rows_are_not_hidden_where_most_are_broken(tmp_path: Path) -> None:
    path = find("underflowed_half").write(tmp_path)
    (finding,) = validate(path, Settings(level=Level.VALUES)).findings
    assert finding.count == finding.total
    assert "hide these rows" not in finding.hint


def test_a_part_of_a_tensor_is_changed_in_a_copy() -> None:
    """Without one, the caller's input or a weight would change with each call."""
    assert line_hint("pose = -pose", first=True) == "Begin `forward` on `pose = -pose`."
    assert line_hint("rows[:, 3] = 1") == "End `forward` on `rows = rows.clone(); rows[:, 3] = 1`."


def test_lines_of_axes_undo_the_exchange() -> None:
    vector = np.random.default_rng(5).normal(size=3)
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        _, _, numbers = _line_of_axes(order, signs).partition("[:, -3:][:, ")
        axes, factors = (
            np.array([int(n) for n in part.strip("[])").split(",")])
            for part in numbers.split("] * torch.tensor(")
        )
        np.testing.assert_allclose(
            _turned_axes(order, signs)(vector[axes] * factors),
            declared_rotation(vector),
            atol=1e-12,
        )

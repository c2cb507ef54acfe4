from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import PropertyMissing, ValueInvalid, ply_properties, read_ply_columns

TEXT = """ply
format ascii 1.0
element vertex 2
property float b
property double a
property uchar c
end_header
1.5 2.5 3
4 5 255
"""


def test_columns_are_grouped_by_name_whatever_their_type(tmp_path: Path) -> None:
    path = tmp_path / "t.ply"
    path.write_text(TEXT)
    assert ply_properties(path) == ("b", "a", "c")
    read = read_ply_columns(path, {"ab": ("a", "b"), "c": ("c",)})
    np.testing.assert_array_equal(read["ab"], [[2.5, 1.5], [5, 4]])
    np.testing.assert_array_equal(read["c"], [[3], [255]])
    assert read["c"].dtype == np.float32


def test_all_missing_properties_are_named(tmp_path: Path) -> None:
    path = tmp_path / "t.ply"
    path.write_text(TEXT)
    with pytest.raises(PropertyMissing, match="the properties x, y are missing; found b, a, c"):
        read_ply_columns(path, {"place": ("x", "a", "y")})


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_values_have_to_be_finite(value: str, tmp_path: Path) -> None:
    path = tmp_path / "t.ply"
    path.write_text(TEXT.replace("4 5 255", f"{value} 5 255"))
    with pytest.raises(ValueInvalid, match="property b: 1 of 2 rows are invalid: row 1 is"):
        read_ply_columns(path, {"b": ("b",)})

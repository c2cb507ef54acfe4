import enum
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import torch

from gsgen.contract.errors import ConfigInvalid
from gsgen.sdk.plugins.argument_values import convert


class Size(enum.Enum):
    SMALL = 1
    LARGE = 2


@pytest.mark.parametrize(
    ("text", "annotation", "expected"),
    [
        ("24", int, 24),
        ("-3", int, -3),
        ("2.5e-3", float, 0.0025),
        ("24", float, 24.0),
        ("24", str, "24"),
        ("a=b", str, "a=b"),
        ("", str, ""),
        ("Yes", bool, True),
        ("0", bool, False),
        ("a/b.pt", Path, Path("a/b.pt")),
        ("high", Literal["low", "high"], "high"),
        ("3", Literal[1, 3], 3),
        ("LARGE", Size, Size.LARGE),
        ("1", Size, Size.SMALL),
        ("none", int | None, None),
        ("7", int | None, 7),
        ("7", str | int, 7),
        ("x", int | str, "x"),
        ("1,2, 3", list[int], [1, 2, 3]),
        ("1,2", tuple[int, ...], (1, 2)),
        ("1,b", tuple[int, str], (1, "b")),
        ("a,b", Sequence[str], ["a", "b"]),
        ("a", list, ["a"]),
        ("", list[int], []),
        ("5", Annotated[int, "how many"], 5),
        ("__import__('os')", Any, "__import__('os')"),
    ],
)
def test_argument_texts_become_declared_types(text: str, annotation: Any, expected: Any) -> None:
    converted = convert(text, annotation, "--arg x")
    assert converted == expected
    assert type(converted) is type(expected)


@pytest.mark.parametrize(
    ("text", "annotation", "words"),
    [
        ("3.5", int, "'3.5' is not a whole number"),
        ("much", float, "'much' is not a number"),
        ("maybe", bool, "'maybe' is not true or false"),
        ("mid", Literal["low", "high"], "'mid' is not one of low, high"),
        ("3", Size, "'3' is not one of 1, 2"),
        ("x", int | None, "'x' is not a whole number or none"),
        ("1,x", list[int], "'1,x' is not list[int], separated by commas"),
        ("1", tuple[int, str], "'1' is not tuple[int, str], separated by commas"),
        ("1", torch.Tensor, "Tensor cannot be written on a command line"),
        ("1", dict[str, int], "dict[str, int] cannot be written on a command line"),
    ],
)
def test_invalid_argument_texts_are_named(text: str, annotation: Any, words: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        convert(text, annotation, "--arg x")
    assert caught.value.where == "--arg x"
    assert words in str(caught.value)

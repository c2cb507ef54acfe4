"""Random manifests, built from the dataclasses and their hints, for property tests."""

import types
import typing
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.manifest import CONTRACT_VERSION, manifest_type

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=5,
)


@cache
def manifests():
    """Manifests of all three kinds, every field of them drawn."""
    # Made once: hypothesis looks through a new strategy for as long as it draws from it.
    kinds = {kind: _any(manifest_type(kind), Hint()) for kind in MANIFEST_KINDS}
    return st.sampled_from(MANIFEST_KINDS).flatmap(kinds.__getitem__)


def _any(hint: Any, limits: Hint) -> st.SearchStrategy:
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _any(args[0], next((arg for arg in args[1:] if isinstance(arg, Hint)), limits))
    if origin is Literal:
        return st.sampled_from(args)
    if origin in (typing.Union, types.UnionType):
        return st.one_of([_any(option, limits) for option in args])
    if origin is tuple:
        size = {"max_size": 3} if args[-1] is Ellipsis else dict.fromkeys(_SIZES, len(args))
        return st.lists(_any(args[0], Hint()), **size).map(tuple)
    if origin is dict:
        return st.dictionaries(st.text(max_size=5), _any(args[1], Hint()), max_size=3)
    if is_dataclass(hint):
        hints = get_type_hints(hint, include_extras=True) | {"contract": Literal[CONTRACT_VERSION]}
        drawn = {f.name: _any(hints[f.name], Hint()) for f in fields(hint)}
        return st.builds(hint, **drawn)
    return _scalar(hint, limits)


_SIZES = ("min_size", "max_size")


def _scalar(hint: Any, limits: Hint) -> st.SearchStrategy:
    if limits.enum and hint is str:
        return st.sampled_from(limits.enum)
    if limits.pattern and hint is str:
        return st.from_regex(limits.pattern, fullmatch=True)
    if hint is str:
        return st.text(min_size=limits.min_length or 0, max_size=8)
    if hint is int:
        return st.integers(limits.minimum, limits.maximum)
    if hint is float:
        low = limits.minimum if limits.exclusive_minimum is None else limits.exclusive_minimum
        finite = {"allow_nan": False, "allow_infinity": False}
        has_upper_limit = limits.exclusive_minimum is not None
        return st.floats(low, limits.maximum, exclude_min=has_upper_limit, **finite)
    return {bool: st.booleans(), type(None): st.none()}[hint]

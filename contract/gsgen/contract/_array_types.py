"""Array type annotations (jaxtyping) without the 30 ms that importing jaxtyping takes.

Nothing evaluates them at run time, where ``Float[np.ndarray, "n 3"]`` is ``np.ndarray``.
"""

__all__ = ["Bool", "Float", "Int", "UInt"]

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt
else:

    class _SubscriptableArray:
        """A run-time stand-in for jaxtyping's array types, such as ``Float[np.ndarray, "n 3"]``."""

        def __class_getitem__(cls, item: tuple[type, str]) -> type:
            return item[0]

    Bool = Float = Int = UInt = _SubscriptableArray

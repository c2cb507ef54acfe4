"""What a type alone cannot say about a manifest field: its text and its limits."""

__all__ = ["Hint"]

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Hint:
    """Rides in ``Annotated[...]`` and ends up in the published JSON Schema."""

    text: str = ""
    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    min_length: int | None = None
    pattern: str | None = None
    enum: tuple[str, ...] = ()

    def keywords(self) -> dict[str, object]:
        """Return the JSON Schema keywords that this hint stands for."""
        by_keyword = {
            "description": self.text or None,
            "minimum": self.minimum,
            "exclusiveMinimum": self.above,
            "maximum": self.maximum,
            "minLength": self.min_length,
            "pattern": self.pattern,
            "enum": list(self.enum) or None,
        }
        return {key: value for key, value in by_keyword.items() if value is not None}

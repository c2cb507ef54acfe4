"""Types of a manifest's values: names, digests and numbers with a lower limit."""

__all__ = [
    "ExtensionName",
    "Fraction",
    "Name",
    "Positive",
    "PositiveFloat",
    "RoleName",
    "RowNumber",
    "Sha256",
]

from typing import Annotated

from gsgen.contract.spec.fields.json_schema import Hint
from gsgen.contract.spec.fields.roles import ROLES

RoleName = Annotated[str, Hint(text="What the input means.", enum=tuple(ROLES))]
Name = Annotated[str, Hint(text="The tensor's name in the graph.", min_length=1)]
Positive = Annotated[int, Hint(minimum=1)]
RowNumber = Annotated[int, Hint(minimum=0)]
Sha256 = Annotated[str, Hint(text="SHA-256, in lower-case hex.", pattern="^[0-9a-f]{64}$")]
Fraction = Annotated[float, Hint(minimum=0)]
PositiveFloat = Annotated[float, Hint(exclusive_minimum=0)]
ExtensionName = Annotated[
    str, Hint(text="The field of its data: x-writer-name.", pattern="^x-[a-z0-9]+(-[a-z0-9]+)*$")
]

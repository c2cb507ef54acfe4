"""Which input is meant by a word: a tensor's name, or a role that one input has."""

__all__ = ["Names"]

from collections.abc import Iterable
from dataclasses import dataclass

from gsgen.contract.errors import UnknownName
from gsgen.sdk.binding.input_binding import InputBinding
from gsgen.sdk.binding.providers.errors import InputInvalid


@dataclass(frozen=True, slots=True)
class Names:
    """The inputs of one model.

    Attributes:
        tensors: Names of the tensors.
        roles: Role → the tensors that have it.
        where: What an error calls the model.
    """

    tensors: frozenset[str]
    roles: dict[str, tuple[str, ...]]
    where: str

    @classmethod
    def of(cls, ports: Iterable[InputBinding], where: str) -> "Names":
        """Return the names and roles of a model's inputs."""
        entries = list(ports)
        roles = {port.role for port in entries if port.role}
        return cls(
            frozenset(port.name for port in entries),
            {role: tuple(p.name for p in entries if p.role == role) for role in roles},
            where,
        )

    def find(self, word: str) -> str:
        """Return the tensor that ``word`` means; a tensor's name comes before a role.

        Raises:
            UnknownName: There is none.
            InputInvalid: Several inputs have that role.
        """
        if word in self.tensors:
            return word
        found = self.roles.get(word, ())
        if not found:
            known = {*self.tensors, *self.roles}
            raise UnknownName.among("input", word, known, where=self.where)
        if len(found) > 1:
            what = (
                f"{len(found)} inputs have role {word!r}, wanted one of {', '.join(found)}"
            )
            raise InputInvalid(what, where=self.where)
        return found[0]

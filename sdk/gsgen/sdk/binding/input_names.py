"""Finds the model input that a tensor name or an input role refers to."""

__all__ = ["InputNames"]

from collections.abc import Iterable
from dataclasses import dataclass

from gsgen.contract.errors import UnknownName
from gsgen.sdk.binding.bound.input_binding import InputBinding
from gsgen.sdk.binding.providers.errors import InputInvalid


@dataclass(frozen=True, slots=True)
class InputNames:
    """The tensor names and the input roles of the inputs of one model."""

    tensors: frozenset[str]  # names of the input tensors
    roles: dict[str, tuple[str, ...]]  # role → names of the tensors that have it
    where: str  # name of the model in errors

    @classmethod
    def from_bindings(cls, ports: Iterable[InputBinding], where: str) -> "InputNames":
        """Collect the tensor names and the input roles of a model's inputs."""
        entries = list(ports)
        roles = {port.role for port in entries if port.role}
        return cls(
            frozenset(port.name for port in entries),
            {role: tuple(p.name for p in entries if p.role == role) for role in roles},
            where,
        )

    def find(self, word: str) -> str:
        """Return the model input with a tensor name, or else with an input role such as ``view``.

        Raises :class:`InputInvalid` if several inputs have the role.
        """
        if word in self.tensors:
            return word
        matches = self.roles.get(word, ())
        if not matches:
            known = {*self.tensors, *self.roles}
            raise UnknownName.among("input", word, known, where=self.where)
        if len(matches) > 1:
            message = (
                f"{len(matches)} inputs have role {word!r}, expected one of {', '.join(matches)}"
            )
            raise InputInvalid(message, where=self.where)
        return matches[0]

"""Put files in their place only when they are whole: what the contract does, for this room, too."""

__all__ = ["atomic_write", "refuse_folder"]

from gsgen.contract.process.atomic_files import atomic_write, refuse_folder

"""Atomic writes of model files, re-exported from the contract for the rooms of the SDK."""

__all__ = ["atomic_write", "refuse_folder"]

from gsgen.contract.process.atomic_files import atomic_write, refuse_folder

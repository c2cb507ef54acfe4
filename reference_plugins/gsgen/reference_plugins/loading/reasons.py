"""Shortens the errors of file readers to one line."""

__all__ = ["reason_of"]

_MAX_CHARACTERS = 300


def reason_of(error: Exception) -> str:
    """Return the line of an error that names the fault of a file.

    ``torch.load`` first advises to load the file without its safeguard, which would be unsafe;
    the refused name comes later.
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "GLOBAL" in line or "Unsupported" in line]
    return (telling or lines or [type(error).__name__])[0][:_MAX_CHARACTERS]

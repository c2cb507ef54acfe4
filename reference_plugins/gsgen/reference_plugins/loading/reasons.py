"""Why a file could not be read, in one line."""

__all__ = ["reason_of"]

_MOST = 300


def reason_of(error: Exception) -> str:
    """Return the line of an error that says what is wrong with a file.

    ``torch.load`` begins with the advice to load the file without its safeguard, which nobody
    should follow; what it refused comes later.
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "GLOBAL" in line or "Unsupported" in line]
    return (telling or lines or [type(error).__name__])[0][:_MOST]

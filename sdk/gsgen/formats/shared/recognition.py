"""The error about a file of another kind than expected, the same in every reader."""

__all__ = ["not_recognised"]

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of
from gsgen.formats.shared.bytes import Data
from gsgen.formats.shared.errors import FormatNotRecognised


def not_recognised(data: Data, expected: str, shown: str) -> FormatNotRecognised:
    """Return the error about a file whose content is not that of the format that is read.

    Args:
        data: The file, or its beginning.
        expected: The expected content.
        shown: The first bytes, for content of no known kind.
    """
    kind = kind_of(bytes(data[:RECOGNITION_BYTES]))
    if kind is None:
        return FormatNotRecognised(shown, where="first bytes", expected=expected)
    return FormatNotRecognised(f"this is {kind.title}", expected=expected, hint=kind.hint)

"""Output paths of a bake: one file, or a pattern with the frame's number."""

__all__ = ["OutputFiles", "writable_codec"]

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.process.atomic_files import refuse_folder
from gsgen.formats import CODECS, Codec, codec_named, codec_of_suffix

_NUMBER_PATTERN: Final = re.compile(r"%(0\d)?d")


@final
@dataclass(frozen=True, slots=True)
class OutputFiles:
    """The paths and the format of the files that a bake writes."""

    pattern: Path
    codec: Codec

    @classmethod
    def of(cls, pattern: Path, frames: int, format: str | None = None) -> "OutputFiles":
        """Check an output path against the number of frames, and choose the format.

        Args:
            pattern: The path, with ``%d`` or ``%04d`` for several frames.
            frames: Number of frames.
            format: Name of a format; None for that of the suffix.
        """
        codec = writable_codec(pattern, format, where=f"-o {pattern}")
        numbers = len(_NUMBER_PATTERN.findall(str(pattern)))
        example_path = pattern.with_name(f"{pattern.name.split('.')[0]}_%04d{codec.suffixes[0]}")
        if numbers > 1:
            raise ConfigInvalid(
                f"has {numbers} frame numbers, expected one",
                where=f"-o {pattern}",
                hint=f"Write for example -o {example_path}.",
            )
        if frames > 1 and not numbers:
            raise ConfigInvalid(
                f"is one file, expected a pattern for {frames} frames",
                where=f"-o {pattern}",
                hint=f"Write the frame's number as %04d, for example -o {example_path}.",
            )
        refuse_folder(pattern)
        return cls(pattern, codec)

    def path(self, number: int) -> Path:
        """Return the output path of frame ``number``, from 0."""
        return Path(
            _NUMBER_PATTERN.sub(lambda match: _frame_digits(match, number), str(self.pattern))
        )


def _frame_digits(match: re.Match[str], number: int) -> str:
    width = int(match[1] or 0)
    return f"{number:0{width}d}" if width else str(number)


def writable_codec(path: Path, format: str | None, where: str) -> Codec:
    """Return the writable splat format with a name, or else with a path's suffix."""
    writable_codecs = [codec for codec in CODECS if codec.write]
    if format is not None:
        if format not in [codec.name for codec in CODECS]:
            raise UnknownName.among(
                "format", format, [codec.name for codec in writable_codecs], where="--format"
            )
        codec: Codec | None = codec_named(format)
        where = f"--format {format}"
    else:
        codec = codec_of_suffix(path)
    if codec is None or codec.write is None:
        suffix = path.suffix or "(none)"
        actual = f"{codec.title} can only be read" if codec else f"has the suffix {suffix}"
        suffixes = ", ".join(known_codec.suffixes[0] for known_codec in writable_codecs)
        raise ConfigInvalid(
            f"{actual}, expected a format that can be written: {suffixes}",
            where=where,
            hint="Change the suffix, or give --format.",
        )
    return codec

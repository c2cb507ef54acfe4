"""Writes MP4 videos: Pillow encodes AV1 frames, which are wrapped in MP4 boxes.

The encoder is Pillow's, whose AVIF sequences hold the same AV1 samples in other boxes. So no codec
with another licence is needed. Boxes: ISO/IEC 14496-12 (ISO base media file format); the
sample entry: "AV1 Codec ISO Media File Format Binding", version 1.2. Sound is PCM: ISO/IEC 23003-5.
"""

__all__ = ["Sound", "encode", "require_encoder"]

import io
import struct
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import Float32

from gsgen.runtime.errors import SceneInvalid

if TYPE_CHECKING:
    from PIL.Image import Image

_TICKS_PER_SECOND: Final = 1000
"""Units of time per frame, so that rates such as 23.976 are stored exactly."""

_GROUP_FRAMES: Final = 48  # frames encoded together; players can seek to the first
_MAX_BYTES: Final = 1 << 32  # offsets have 32 bits
_ENCODER_QUALITY: Final = 80
_ENCODER_SPEED: Final = 8  # of 10; 6 takes four times as long for the same size at this quality
_ENTRY_FIELDS: Final = 8 + 78  # bytes of a visual sample entry before its boxes
_IDENTITY_MATRIX: Final = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sound:
    """The sound of a film: samples in [−1, 1), and how many a second."""

    samples: Float32[np.ndarray, " n"]
    rate: int

    @property
    def data(self) -> bytes:
        """The samples as little-endian integers of 16 bits."""
        whole = np.clip(np.rint(self.samples * 2**15), -(2**15), 2**15 - 1)
        return bytes(whole.astype("<i2").tobytes())


def encode(pictures: Iterable["Image"], fps: float, sound: Sound | None = None) -> bytes:
    """Encode pictures of one size as an MP4 file, with few of them in memory at a time.

    Args:
        pictures: The frames.
        fps: Frames a second.
        sound: What is heard from the first frame on; None for a silent film.

    Raises:
        SceneInvalid: Pillow has no AV1 encoder, the pictures differ in size, or the video
            exceeds 4 GiB.
    """
    groups = [_encode_group(group) for group in _split_groups(iter(pictures))]
    if len(sizes := {(group.width, group.height) for group in groups}) > 1:
        raise _size_mismatch(sizes)
    samples = [sample for group in groups for sample in group.samples]
    first_samples = np.cumsum([1, *(len(group.samples) for group in groups[:-1])])
    ftyp_box = _mp4_box(b"ftyp", b"isom", _uint32_bytes(0x200), b"isomiso6av01mp41")
    heard = b"" if sound is None else sound.data

    def moov(offset: int, sound_offset: int) -> bytes:
        """Return the table of contents of frames and sound that begin at these bytes."""
        tracks = [_video_track(groups[0], samples, first_samples.tolist(), fps, offset)]
        if sound is not None:
            tracks.append(_sound_track(sound, fps, sound_offset))
        return _moov_box(tracks, len(samples), fps)

    # The table stores the offset of the samples, which depends on the table's length. The length
    # does not depend on the offset, so the table is built twice.
    size = len(ftyp_box) + len(moov(0, 0)) + 8
    sound_offset = size + sum(map(len, samples))
    if sound_offset + len(heard) >= _MAX_BYTES:
        raise SceneInvalid(
            f"the {len(samples):,} frames take more than 4 GiB, the limit of an .mp4 file",
            hint="Draw the video in parts, or smaller.",
        )
    return b"".join([ftyp_box, moov(size, sound_offset), _mp4_box(b"mdat", *samples, heard)])


def require_encoder() -> None:
    """Raise if the installed pillow has no AV1 encoder."""
    from PIL import features

    if not features.check("avif"):
        raise SceneInvalid(
            "this pillow has no AV1 encoder, which .mp4 files need",
            hint="Install a wheel of pillow 11.3 or newer, or write a .gif.",
        )


@final
@dataclass(frozen=True, slots=True)
class _Group:
    """AV1 frames of a video that were encoded together, and the MP4 sample entry that they need."""

    entry: bytes
    samples: list[bytes]
    width: int
    height: int


def _split_groups(pictures: Iterator["Image"]) -> Iterator[list["Image"]]:
    """Divide video pictures into groups to encode; a group of one would become a still image.

    AVIF stores a sequence of one picture as a still image, which has other boxes. Only a video of
    one picture has such a group.
    """
    group = list(islice(pictures, _GROUP_FRAMES))
    while len(next_group := list(islice(pictures, _GROUP_FRAMES))) > 1:
        yield group
        group = next_group
    yield group + next_group


def _encode_group(pictures: Sequence["Image"]) -> _Group:
    """Encode pictures as an AVIF sequence, and extract the AV1 samples from it."""
    require_encoder()
    if len(picture_sizes := {picture.size for picture in pictures}) > 1:
        raise _size_mismatch(picture_sizes)
    first, *remaining = pictures
    buffer = io.BytesIO()
    first.save(
        buffer,
        "AVIF",
        save_all=True,
        append_images=remaining or [first],
        duration=1,
        quality=_ENCODER_QUALITY,
        speed=_ENCODER_SPEED,
        range="limited",  # the default that players assume
    )
    file = buffer.getvalue()
    table = _find_box(file, b"moov", b"trak", b"mdia", b"minf", b"stbl")
    lengths = np.frombuffer(_find_box(table, b"stsz"), ">u4")[3:]
    start = int.from_bytes(_find_box(table, b"stco")[8:12], "big")
    ends = start + np.cumsum(lengths)
    samples = [file[end - size : end] for size, end in zip(lengths, ends, strict=True)]
    entry = _mp4_sample_entry(_find_box(table, b"stsd")[8:])
    return _Group(entry, samples[: len(pictures)], first.width, first.height)


def _size_mismatch(sizes: Collection[tuple[int, int]]) -> SceneInvalid:
    size_list = ", ".join(f"{width}×{height}" for width, height in sorted(sizes))
    return SceneInvalid(
        f"frames have several sizes ({size_list}), expected one size for a video",
        hint="Give --width and --height.",
    )


def _mp4_sample_entry(avif: bytes) -> bytes:
    """Convert the sample entry of an AVIF sequence to that of an MP4 video."""
    kept_boxes = {b"av1C", b"colr"}
    boxes = [
        _mp4_box(kind, body)
        for kind, body in _mp4_boxes(avif[_ENTRY_FIELDS:])
        if kind in kept_boxes
    ]
    return _mp4_box(b"av01", avif[8:_ENTRY_FIELDS], *boxes)


def _moov_box(tracks: Sequence[bytes], frames: int, fps: float) -> bytes:
    """Return the MP4 box ``moov`` of a film of some frames."""
    rate, duration = round(_TICKS_PER_SECOND * fps), _TICKS_PER_SECOND * frames
    header = _uint32_bytes(0, 0, 0, rate, duration, 0x10000, 0x1000000, 0, 0)
    last = _uint32_bytes(len(tracks) + 1)
    return _mp4_box(b"moov", _mp4_box(b"mvhd", header, _IDENTITY_MATRIX, bytes(24), last), *tracks)


def _video_track(
    group: _Group, samples: Sequence[bytes], first_samples: Sequence[int], fps: float, offset: int
) -> bytes:
    """Return the MP4 box ``trak`` of consecutive frames that begin at byte ``offset``."""
    table = [
        _mp4_box(b"stsd", _uint32_bytes(0, 1), group.entry),
        _mp4_box(b"stts", _uint32_bytes(0, 1, len(samples), _TICKS_PER_SECOND)),
        _mp4_box(b"stss", _uint32_bytes(0, len(first_samples), *first_samples)),
        _mp4_box(b"stsc", _uint32_bytes(0, 1, 1, len(samples), 1)),
        _mp4_box(b"stsz", _uint32_bytes(0, 0, len(samples), *map(len, samples))),
        _mp4_box(b"stco", _uint32_bytes(0, 1, offset)),
    ]
    rate, duration = round(_TICKS_PER_SECOND * fps), _TICKS_PER_SECOND * len(samples)
    header = _mp4_box(b"vmhd", _uint32_bytes(1, 0, 0))
    # Flags enabled and in movie; track 1.
    fields = _uint32_bytes(3, 0, 0, 1, 0, duration, 0, 0, 0, 0)
    size = _uint32_bytes(group.width << 16, group.height << 16)
    media = _media_box(b"vide", rate, duration, header, table)
    return _mp4_box(b"trak", _mp4_box(b"tkhd", fields, _IDENTITY_MATRIX, size), media)


def _sound_track(sound: Sound, fps: float, offset: int) -> bytes:
    """Return the MP4 box ``trak`` of PCM samples that begin at byte ``offset``."""
    count = len(sound.samples)
    config = _mp4_box(b"pcmC", _uint32_bytes(0), bytes([1, 16]))  # little-endian, 16 bits
    entry = _mp4_box(
        b"ipcm",
        _uint32_bytes(0, 1, 0, 0),  # of the first data reference
        struct.pack(">HHI", 1, 16, 0),  # one channel
        _uint32_bytes(sound.rate << 16),
        config,
    )
    table = [
        _mp4_box(b"stsd", _uint32_bytes(0, 1), entry),
        _mp4_box(b"stts", _uint32_bytes(0, 1, count, 1)),
        _mp4_box(b"stsc", _uint32_bytes(0, 1, 1, count, 1)),
        _mp4_box(b"stsz", _uint32_bytes(0, 2, count)),
        _mp4_box(b"stco", _uint32_bytes(0, 1, offset)),
    ]
    duration = round(count / sound.rate * _TICKS_PER_SECOND * fps)
    header = _mp4_box(b"smhd", _uint32_bytes(0, 0))
    # Flags enabled and in movie; track 2, of full volume.
    fields = _uint32_bytes(3, 0, 0, 2, 0, duration, 0, 0, 0, 0x1000000)
    media = _media_box(b"soun", sound.rate, count, header, table)
    return _mp4_box(b"trak", _mp4_box(b"tkhd", fields, _IDENTITY_MATRIX, bytes(8)), media)


def _media_box(
    kind: bytes, rate: int, duration: int, header: bytes, table: Sequence[bytes]
) -> bytes:
    """Return the MP4 box ``mdia`` of a track: its clock, its kind and its samples."""
    data_reference = _mp4_box(b"dref", _uint32_bytes(0, 1), _mp4_box(b"url ", _uint32_bytes(1)))
    return _mp4_box(
        b"mdia",
        _mp4_box(b"mdhd", _uint32_bytes(0, 0, 0, rate, duration, 0x55C40000)),  # "und": no language
        _mp4_box(b"hdlr", _uint32_bytes(0, 0), kind, _uint32_bytes(0, 0, 0), b"\0"),
        _mp4_box(b"minf", header, _mp4_box(b"dinf", data_reference), _mp4_box(b"stbl", *table)),
    )


def _uint32_bytes(*values: int) -> bytes:
    return struct.pack(f">{len(values)}I", *values)


def _mp4_box(kind: bytes, *parts: bytes) -> bytes:
    """Return an MP4 box: its length, its type and its content."""
    return b"".join([_uint32_bytes(8 + sum(map(len, parts))), kind, *parts])


def _mp4_boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield the type and the content of each MP4 box in ``data``."""
    offset = 0
    while offset < len(data):
        size = int.from_bytes(data[offset : offset + 4], "big")
        yield data[offset + 4 : offset + 8], data[offset + 8 : offset + size]
        offset += size


def _find_box(data: bytes, *path: bytes) -> bytes:
    """Return the content of the MP4 box at a path of box types."""
    for kind in path:
        data = next(body for box_kind, body in _mp4_boxes(data) if box_kind == kind)
    return data

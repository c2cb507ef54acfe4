"""Reads a streamed SOG as a tileset: each leaf of its lod-meta.json is a chain of tiles.

The format is that of PlayCanvas (playcanvas/splat-transform, "Streamed SOG", version 1). A leaf has
rows of SOG files at several levels of detail; each level is a tile that the next finer one replaces.
All coarsest levels are below the root, which holds the environment, if there is one.
"""

__all__ = ["SogFiles", "is_streamed_sog", "load_streamed_sog"]

import math
import posixpath
from collections import OrderedDict, defaultdict
from collections.abc import Callable
from threading import Lock
from typing import Final, final

import numpy as np

from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.contract.spec.spherical_harmonics import MAX_DEGREE
from gsgen.formats.shared.errors import FormatError
from gsgen.formats.shared.splats import SPLAT_ARRAY_NAMES, Splats
from gsgen.formats.sog.sog import decode_sog
from gsgen.formats.sog.streamed import StreamedLeaf, read_tree
from gsgen.tiles.errors import Fault, TilesetInvalid
from gsgen.tiles.format.json_values import MAX_JSON, is_number, parse_object
from gsgen.tiles.format.tileset import Content, Tile, Tileset
from gsgen.tiles.format.volumes import Box
from gsgen.tiles.loading.limits import Limits
from gsgen.tiles.stores.store import Store

_UPRIGHT: Final = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From the frame of SOG files, y down, to a world whose z is up."""
_BYTES_PER_SPLAT: Final = 14  # of SOG at degree 0: a file does not say how much of it a leaf takes
_HELD_BYTES: Final = 256 << 20  # of decoded files, whose other leaves may be asked for next

ReadFile = Callable[[str, int], bytes]
"""Returns the content of a file; raises if it has more bytes than the second argument."""


def is_streamed_sog(index: str) -> bool:
    """Return whether the path of an index is that of a streamed SOG."""
    return posixpath.basename(index).lower() == STREAMED_META


def load_streamed_sog(store: Store, index: str, limits: Limits, name: str) -> Tileset:
    """Read the tree of a streamed SOG from its lod-meta.json; SOG files are not read.

    Raises:
        TilesetInvalid: The file breaks the rules of the format.
    """
    location = f"{index}, "
    document = parse_object(store.read(index, limit=MAX_JSON), location)
    try:
        tree = read_tree(document.values)
    except FormatError as error:
        raise _invalid(error, store.name) from error
    if sum(len(leaf.levels) for leaf in tree.leaves) >= limits.tiles:
        raise TilesetInvalid(
            f"the streamed SOG has more than {limits.tiles:,} levels of leaves",
            location=f"{location}tree",
            expected="fewer",
        )
    folder = posixpath.dirname(index)
    files = [posixpath.join(folder, file) for file in tree.files]
    coarsest = max(max(leaf.levels) for leaf in tree.leaves)
    boxes = [_box(leaf, f"{location}tree, leaf {row}") for row, leaf in enumerate(tree.leaves)]
    leaves = [
        _chain(leaf, box, files, coarsest, f"{location}tree, leaf {row}")
        for row, (leaf, box) in enumerate(zip(tree.leaves, boxes, strict=True))
    ]
    corners = np.concatenate([box.samples() for box in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    contents: tuple[Content, ...] = ()
    if tree.environment is not None:
        uri = posixpath.join(folder, tree.environment)
        contents = (
            Content(uri=uri, volume=None, location=f"{location}environment", rows=slice(None)),
        )
    diagonal = float(np.linalg.norm(high - low))
    root = Tile(
        location=f"{location}tree",
        volume=Box((low + high) / 2, np.diag((high - low) / 2)),
        geometric_error=diagonal,
        refine="ADD",
        transform=np.eye(4),
        contents=contents,
        children=tuple(leaves),
    )
    return Tileset(
        name=name,
        index=index,
        version="1.1",
        geometric_error=diagonal,
        transform=_UPRIGHT,
        root=root,
        metadata={"sh_degree": _degree(store, files[0])},
        y_up=False,
    )


def _box(leaf: StreamedLeaf, location: str) -> Box:
    bound = leaf.bound if isinstance(leaf.bound, dict) else {}
    corners = [
        corner
        for corner in (bound.get("min"), bound.get("max"))
        if isinstance(corner, list) and len(corner) == 3 and all(map(is_number, corner))
    ]
    if len(corners) != 2 or not (np.array(corners[0]) <= corners[1]).all():
        raise TilesetInvalid(
            f"bound {leaf.bound!s:.60}",
            location=location,
            expected="min and max of 3 numbers, min of max or less",
        )
    low, high = np.array(corners, np.float64)
    return Box((low + high) / 2, np.diag((high - low) / 2))


def _chain(leaf: StreamedLeaf, box: Box, files: list[str], coarsest: int, location: str) -> Tile:
    """Return the tile of a leaf's coarsest level, with those of its finer levels below it."""
    diagonal = 2 * float(np.linalg.norm(box.half_axes))
    told = leaf.errors if isinstance(leaf.errors, list) else []
    tile: Tile | None = None
    for level, rows in leaf.levels.items():  # finest first
        # The file states squared differences of pictures over their squares. Their root is the
        # share of the leaf's size by which the level differs; cells on a surface are its default.
        share = told[level] if level < len(told) else 16 / rows.count
        if not (is_number(share) and share >= 0):
            raise TilesetInvalid(
                f"errors {told!s:.60}", location=location, expected="numbers of 0 or more"
            )
        error = max(tile.geometric_error, diagonal * math.sqrt(share)) if tile else 0.0
        end = rows.offset + rows.count
        content = Content(
            uri=files[rows.file],
            volume=None,
            location=f"{location}, lods.{level}",
            rows=slice(rows.offset, end),
        )
        tile = Tile(
            location=content.location,
            volume=box,
            geometric_error=error,
            refine="REPLACE",
            transform=np.eye(4),
            contents=(content,),
            children=(tile,) if tile else (),
            level=1 + coarsest - level,
            metadata={"splats": rows.count, "bytes": [_BYTES_PER_SPLAT * rows.count]},
        )
    assert tile is not None  # a leaf has a level
    return tile


def _degree(store: Store, file: str) -> int:
    """Return the degree of the harmonics of a SOG file, as its meta.json tells."""
    if posixpath.basename(file).lower() != META_FILE:
        return MAX_DEGREE
    harmonics = parse_object(store.read(file, limit=MAX_JSON), f"{file}, ").values.get("shN")
    bands = harmonics.get("bands", MAX_DEGREE) if isinstance(harmonics, dict) else 0
    return bands if bands in range(MAX_DEGREE + 1) else MAX_DEGREE


def _invalid(error: FormatError, name: str) -> TilesetInvalid:
    return TilesetInvalid(
        error.message,
        location=": ".join(part for part in (name, error.path, error.where) if part),
        expected=error.expected,
        hint=error.hint,
        fault=Fault.CONTENT,
    )


@final
class SogFiles:
    """Decodes the files of a streamed SOG, each once for the tiles that are rows of it.

    Safe to use from many threads: tiles of a file that is on its way wait for it.

    Attributes:
        sizes: Bytes of each file, those of its pictures included.
    """

    def __init__(self) -> None:
        self.sizes: dict[str, int] = {}
        self._lock = Lock()
        self._file_locks: defaultdict[str, Lock] = defaultdict(Lock)
        self._files: OrderedDict[str, Splats] = OrderedDict()

    def read(self, content: Content, read_file: ReadFile) -> Splats:
        """Return the rows of a content.

        Args:
            content: Of a tile of :func:`load_streamed_sog`.
            read_file: Reads a file by its path in the store.

        Raises:
            TilesetInvalid: The file is missing or wrong, or has fewer rows.
        """
        uri, rows = content.uri, content.rows or slice(None)
        with self._lock:
            file_lock = self._file_locks[uri]
        with file_lock:
            splats = self._files.get(uri)
            if splats is None:
                splats, self.sizes[uri] = _decode(uri, read_file)
            self._keep(uri, splats)
        if rows.stop is not None and rows.stop > len(splats):
            raise TilesetInvalid(
                f"the tree lists row {rows.stop - 1} of {uri}",
                location=content.location,
                expected=f"rows from 0 to {len(splats) - 1}, as that file has",
                fault=Fault.COUNTS,
            )
        return splats[rows]

    def _keep(self, uri: str, splats: Splats) -> None:
        """Hold a file as the one that was asked for last; the others leave for it."""
        with self._lock:
            self._files[uri] = splats
            self._files.move_to_end(uri)
            while len(self._files) > 1 and sum(map(_memory, self._files.values())) > _HELD_BYTES:
                self._files.popitem(last=False)


def _memory(splats: Splats) -> int:
    return sum(getattr(splats, name).nbytes for name in SPLAT_ARRAY_NAMES)


def _decode(uri: str, read_file: ReadFile) -> tuple[Splats, int]:
    """Return the splats of a SOG file, and the bytes that were read for them."""
    folder, name = posixpath.split(uri)
    sizes: list[int] = []

    def fetch(file: str, limit: int) -> bytes:
        if posixpath.basename(file) != file or file in ("", ".", ".."):
            raise TilesetInvalid(
                f"image {file!r:.60}",
                location=uri,
                expected="the name of a file in the same folder",
                fault=Fault.URI,
            )
        data = read_file(posixpath.join(folder, file), limit)
        sizes.append(len(data))
        return data

    try:
        return decode_sog(name, fetch), sum(sizes)
    except FormatError as error:
        raise _invalid(error, folder) from error

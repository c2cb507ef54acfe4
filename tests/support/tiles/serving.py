"""A server of tilesets that runs while a test does."""

import threading
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from gsgen.tiles.serving.faults import NetworkFaults
from gsgen.tiles.serving.server import serve_folder


@contextmanager
def served(
    folder: Path, faults: NetworkFaults | None = None, *, cors: Collection[str] = ()
) -> Iterator[str]:
    """Serve a folder on a free port, and yield the address."""
    with serve_folder(folder, faults=faults, cors=cors) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.address
        finally:
            server.shutdown()
            thread.join()

"""Measure `gsgen tiles serve`: seconds a file on one connection, with 50 clients, and half-open ones.

Prints each figure with its bar, and exits 1 if one is missed.

    .venv/bin/python tests/bench/bench_serve.py
"""

import asyncio
import socket
import subprocess
import sys
import tempfile
import time
from http.client import HTTPConnection
from pathlib import Path

import numpy as np

FILES, FILE_BYTES = 100, 40_000
CLIENTS, FILES_EACH = 50, 10
HALF_OPEN = 200
BAR_MEDIAN, BAR_P99 = 2e-3, 0.5


def main() -> int:
    """Serve a folder in a process, and measure."""
    with tempfile.TemporaryDirectory() as folder:
        data = np.random.default_rng(0).bytes(FILE_BYTES)
        for index in range(FILES):
            (Path(folder) / f"{index}.glb").write_bytes(data)
        command = [sys.executable, "-m", "gsgen.cli", "tiles", "serve", folder, "--port", "0"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert server.stdout is not None
        port = int(server.stdout.readline().decode().strip().rstrip("/").rpartition(":")[2])
        try:
            return _measure(port)
        finally:
            server.terminate()
            server.wait()


def _measure(port: int) -> int:
    _keep_alive(port)  # the first answers are slower
    misses = _print("keep-alive, median", float(np.median(_keep_alive(port))), BAR_MEDIAN)
    times = asyncio.run(_many_clients(port))
    misses += _print(f"{CLIENTS} clients × {FILES_EACH} files, p99", _p99(times), BAR_P99)
    waiting = [socket.create_connection(("127.0.0.1", port)) for _ in range(HALF_OPEN)]
    for index, connection in enumerate(waiting):
        connection.sendall(b"GET /0.glb HTTP/1.1\r\nHost: "[: index % 30])
    name = f"beside {HALF_OPEN} half-open connections"
    misses += _print(f"{name}, median", float(np.median(_keep_alive(port))), BAR_MEDIAN)
    misses += _print(f"{name}, p99", _p99(asyncio.run(_many_clients(port))), BAR_P99)
    for connection in waiting:
        connection.close()
    return int(misses > 0)


def _print(name: str, seconds: float, bar: float) -> int:
    """Print a figure with its bar; return 1 if it is missed."""
    print(f"{name:<48} {seconds * 1e3:8.2f} ms; bar {bar * 1e3:g} ms")
    return int(seconds > bar)


def _p99(times: list[float]) -> float:
    return float(np.percentile(times, 99))


def _keep_alive(port: int) -> list[float]:
    """Return the seconds of each file on one connection."""
    connection = HTTPConnection("127.0.0.1", port)
    times = []
    for index in range(FILES):
        start = time.perf_counter()
        connection.request("GET", f"/{index}.glb")
        response = connection.getresponse()
        assert len(response.read()) == FILE_BYTES, response.status
        times.append(time.perf_counter() - start)
    connection.close()
    return times


async def _many_clients(port: int) -> list[float]:
    """Return the seconds of each file of clients that begin at once."""
    times: list[float] = []
    await asyncio.gather(*(_client(port, number, times) for number in range(CLIENTS)))
    return times


async def _client(port: int, number: int, times: list[float]) -> None:
    start = time.perf_counter()  # the first file's time holds the connection's
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    for index in range(FILES_EACH):
        path = (number * FILES_EACH + index) % FILES
        writer.write(f"GET /{path}.glb HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        await reader.readexactly(FILE_BYTES)
        times.append(time.perf_counter() - start)
        start = time.perf_counter()
    writer.close()
    await writer.wait_closed()


if __name__ == "__main__":
    raise SystemExit(main())

"""The confined child process that runs models: it confines itself before it imports libraries.

It ends with the control channel, which the system closes with the parent.
"""

__all__ = ["main"]

import os
import socket
import sys
from pathlib import Path

from gsgen.contract.process.confinement import confine
from gsgen.sdk.binding.confined.messages import receive

_LOG_BYTES = 1 << 20  # of the only file that a process without a GPU writes, its log


def main(descriptor: int) -> None:
    """Confine this process, and serve the sessions that the parent asks for."""
    control = socket.socket(fileno=descriptor)
    job, _ = receive(control)
    if job is not None:
        # Drivers keep buffers in files in memory.
        file_bytes = job["memory"] if job["has_gpu"] else _LOG_BYTES
        confine(map(Path, job["readable"]), file_bytes=file_bytes, has_gpu=job["has_gpu"])
        from gsgen.sdk.binding.confined.serving import serve_sessions

        serve_sessions(control, job)
    os._exit(0)  # a run of ONNX Runtime cannot be waited for


if __name__ == "__main__":
    main(int(sys.argv[1]))

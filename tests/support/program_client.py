"""A program that asks a server to fork it; its text is the start of the programs on the PATH.

It imports little, as it starts once for each command that a page types.
"""

import json
import os
import signal
import socket
import sys


def serve_or_replace(
    real: str, socket_path: str, surroundings: dict[str, str], module: str
) -> None:
    """Let the server run this program, or run the real one where a fork would differ from it.

    Args:
        real: The program that this one stands for.
        socket_path: Where the server listens.
        surroundings: The variables of Python that the server has.
        module: What may follow `python -m`; empty for nothing.
    """
    program = os.path.basename(sys.argv[0])
    names = [name for name in os.environ if name.startswith("PYTHON") and "IOENCODING" not in name]
    own = {name: os.environ[name] for name in names}
    is_script = len(sys.argv) > 1 and sys.argv[1].endswith(".py") and not module
    is_module = bool(module) and sys.argv[1:3] == ["-m", module]
    if own != surroundings or (program == "python" and not (is_script or is_module)):
        os.execv(real, [real, *sys.argv[1:]])
    request = {
        "program": program,
        "arguments": sys.argv if program == "gsgen" else sys.argv[1:],
        "folder": os.getcwd(),
        "environment": dict(os.environ),
    }
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.connect(socket_path)
        socket.send_fds(server, [json.dumps(request).encode()], [0, 1, 2])
        child = int(server.recv(64))
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, lambda received, _: os.kill(child, received))
        code = int(server.recv(64))
    sys.exit(code if code >= 0 else 128 - code)

"""A program that asks a server to fork it; its text is the start of the programs on the PATH.

It imports little, as it starts once for each command that a page types.
"""

import json
import os
import signal
import socket
import sys


def serve_or_replace(
    real: str, socket_path: str, surroundings: dict[str, str], modules: tuple[str, ...]
) -> None:
    """Let the server run this program, or run the real one where a fork would differ from it.

    Args:
        real: The program that this one stands for.
        socket_path: Where the server listens.
        surroundings: The variables of Python that the server has. Where it has no PYTHONPATH, its
            fork takes that of this program.
        modules: What may follow `python -m`; a script may where `gsgen.cli` may.
    """
    program = os.path.basename(sys.argv[0])
    names = [name for name in os.environ if name.startswith("PYTHON") and "IOENCODING" not in name]
    own = {name: os.environ[name] for name in names}
    if "PYTHONPATH" not in surroundings:
        own.pop("PYTHONPATH", None)
    words = sys.argv[1:] or [""]
    is_script = words[0].endswith(".py") and "gsgen.cli" in modules
    is_module = words[0] == "-m" and len(words) > 1 and words[1] in modules
    if own != surroundings or (program == "python" and not (is_script or is_module)):
        os.execv(real, [real, *sys.argv[1:]])
    request = {
        "program": program,
        "arguments": sys.argv[1:] if program == "python" else sys.argv,
        "python": os.path.join(os.path.dirname(os.path.abspath(sys.argv[0])), "python"),
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

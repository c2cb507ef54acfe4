"""The processor time of commands, which benches compare."""

import resource
import subprocess


def cpu_seconds(command: list[str], environment: dict[str, str]) -> float:
    """Return the processor time of a command, children included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

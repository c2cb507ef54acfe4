"""Confines a child process that runs a stranger's model, as far as the system can.

On Linux, Landlock takes away all files but those that are named, and a filter of system calls takes
away the network, other processes and programs. Every system limits the size of written files.
"""

__all__ = ["Confinement", "available_confinement", "confine"]

import os
import site
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

# What Python, libraries and drivers read; none of it is the user's.
_SYSTEM_FILES: Final = (
    *("/usr", "/lib", "/lib32", "/lib64", "/opt", "/nix/store", "/run/opengl-driver", "/sys"),
    *("/etc/ld.so.cache", "/etc/localtime", "/etc/os-release", "/etc/drirc", "/etc/glvnd"),
    *("/etc/vulkan", "/etc/OpenCL", "/etc/nvidia"),
    *("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/filesystems"),
    *("/proc/sys", "/proc/devices", "/proc/modules", "/proc/driver"),
)
_PLAIN_DEVICES: Final = ("/dev/null", "/dev/zero", "/dev/full", "/dev/urandom", "/dev/random")
_GPU_DEVICES: Final = ("/dev/dri", "/dev/dxg", "/dev/kfd")
_GPU_DEVICE_PREFIX: Final = "nvidia"


@dataclass(frozen=True, slots=True)
class Confinement:
    """The mechanisms that confine a process on this system.

    Attributes:
        files: All files are denied but those that are named: the version of Landlock, 0 without.
        calls: Network, other processes and programs are denied, by a filter of system calls.
    """

    files: int
    calls: bool


def available_confinement() -> Confinement:
    """Return the mechanisms that this system offers to a process without privileges."""
    from gsgen.contract.process import landlock, system_call_filter

    return Confinement(landlock.version(), system_call_filter.is_available())


def confine(
    readable: Iterable[Path],
    writable: Iterable[Path] = (),
    *,
    file_bytes: int,
    has_gpu: bool = False,
) -> Confinement:
    """Confine this process before it starts threads or reads a stranger's file.

    Args:
        readable: Files that it may read besides Python's, libraries' and drivers'.
        writable: Folders that it may write to.
        file_bytes: The largest size of a file that it writes.
        has_gpu: Allow the devices of graphics drivers.

    Returns:
        What is in force.
    """
    _limit_files(file_bytes)
    confinement = available_confinement()
    if confinement.files:
        from gsgen.contract.process.landlock import restrict_files

        devices = [Path(name) for name in (*_PLAIN_DEVICES, *(_GPU_DEVICES if has_gpu else ()))]
        if has_gpu and os.path.isdir("/dev"):
            devices += [path for path in Path("/dev").iterdir() if _is_gpu(path)]
        restrict_files([*_program_folders(), *readable], writable, devices)
    if confinement.calls:
        from gsgen.contract.process.system_call_filter import forbid_system_calls

        forbid_system_calls()
    return confinement


def _is_gpu(path: Path) -> bool:
    return path.name.startswith(_GPU_DEVICE_PREFIX)


def _limit_files(file_bytes: int) -> None:
    """Limit the size of written files; also forbid processes, where threads do not count as such."""
    if os.name == "nt":
        return
    import resource

    _, hard_limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    hard_limit = sys.maxsize if hard_limit == resource.RLIM_INFINITY else hard_limit
    resource.setrlimit(resource.RLIMIT_FSIZE, (min(file_bytes, hard_limit),) * 2)
    if sys.platform == "darwin":
        resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))


def _program_folders() -> list[Path]:
    """Return files of the system, Python and its packages, but no folder that holds the home."""
    packages = [Path(path) for path in sys.modules["gsgen"].__path__]
    python_folders = [
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        *sys.path,
        site.getusersitepackages(),
    ]
    libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    folders = [
        *map(Path, (*_SYSTEM_FILES, *filter(None, (*python_folders, *libraries)))),
        *packages,
    ]
    try:
        home_folder = Path.home().resolve()
    except RuntimeError:  # a user without a home, as in containers
        return folders
    return [folder for folder in folders if not home_folder.is_relative_to(folder.resolve())]

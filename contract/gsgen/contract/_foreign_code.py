"""Runs code of third parties, such as plugins, so that it cannot end this process unnoticed.

``except Exception`` misses SystemExit, so a plugin that calls ``sys.exit()`` would end a validation
with exit code 0, which reads as a pass.
"""

__all__ = ["ForeignExit", "describe_exception", "foreign_code"]

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Never

_MAX_CHARACTERS = 300


class ForeignExit(Exception):
    """Raised if a third party's code tried to end this process; its cause is what was raised."""


@contextmanager
def foreign_code() -> Iterator[None]:
    """Turn exceptions of the block that are no Exception, and ``os._exit``, into ForeignExit.

    Ctrl-C still raises KeyboardInterrupt. ``os._exit`` ends other threads' processes as before, and
    those that the block forks.
    """
    exit_process, caller = os._exit, (os.getpid(), threading.get_ident())

    def refuse_exit(status: int) -> Never:
        if (os.getpid(), threading.get_ident()) != caller:
            exit_process(status)
        raise ForeignExit(f"os._exit({status!r})")

    os._exit = refuse_exit
    try:
        yield
    except (Exception, KeyboardInterrupt):
        raise
    except BaseException as error:
        described = ForeignExit(describe_exception(error)).with_traceback(error.__traceback__)
        raise described from error
    finally:
        os._exit = exit_process


def describe_exception(error: BaseException) -> str:
    """Return the ``repr`` of an exception in one short line, even if its class cannot make one."""
    try:
        with foreign_code():
            text = str(error) if isinstance(error, ForeignExit) else repr(error)
            text = " ".join(text.split())
    except Exception:  # the class is a third party's
        text = f"{object.__repr__(error)}, which has no readable message"
    return text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]} …"

"""How a process of Cairn ends."""

import atexit
import os
import sys
import threading
from contextlib import suppress
from typing import NoReturn


def end_process(code: int) -> NoReturn:
    """End the calling process with that exit code, whatever its other threads are doing.

    Python unwinds a thread that is within a library when the interpreter ends, which Rust code
    (Zenoh) answers by aborting: the process would end by SIGABRT instead of with its code. So where
    threads are left, as after a component that hangs, Python's own end is left out.
    """
    if threading.active_count() > 1:
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # a full disk, or a reader that has gone: the code still tells
                stream.flush()
        os._exit(code)
    sys.exit(code)

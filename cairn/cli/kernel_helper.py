"""Has another process compile the kernels that a command imports.

A compiler keeps about 200 MiB, which the command then does not have.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial

from cairn.processes.orphan_cleanup import set_parent_death_signal
from cairn.processes.zygote import BOOTSTRAP
from cairn.system.files import explain_os_error
from cairn.system.kernel_compilation import (
    COMPILATION_LIMIT_S,
    compile_deferred,
    deferred_compilation,
)
from cairn.terminal.output import note

PACKAGES = ("cairn", "cairn_lab")
"""The packages whose kernels are compiled: they may be imported in any process."""


def compile_in_helper() -> None:
    """Have another process fill the cache with the kernels of what is being imported.

    It ends with this process. If it fails, this process compiles.
    """
    note("compiling kernels, once after an installation or an update: up to a minute")
    began = time.monotonic()
    modules = [name for name in sorted(sys.modules) if name.split(".")[0] in PACKAGES]
    # Not from the current folder, and apart from the terminal, whose Ctrl-C this process receives.
    bootstrap = ["-P", "-c", BOOTSTRAP, json.dumps(sys.path), "cairn.cli.kernel_helper:main"]
    try:
        done = subprocess.run(
            [sys.executable, *bootstrap, str(os.getpid()), *modules],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
            timeout=COMPILATION_LIMIT_S,
            check=False,
        )
        fault = f"exit code {done.returncode}" if done.returncode else ""
    except subprocess.TimeoutExpired:
        fault = f"not ready after {COMPILATION_LIMIT_S:g} s"
    except OSError as error:
        fault = explain_os_error(error)
    if fault:
        note(f"compiling kernels in this process: helper process: {fault}")
    else:
        note(f"compiled kernels in {time.monotonic() - began:.0f} s")


def main() -> None:
    """Import the modules, and compile all kernels of these and of what they import."""
    _, _, parent, *modules = sys.argv
    end_with_parent = partial(set_parent_death_signal, signal.SIGKILL)
    end_with_parent()
    if os.getppid() != int(parent):  # it ended before it could be noticed
        return
    with deferred_compilation():
        for name in modules:
            with suppress(Exception):  # the command imports it as well, and reports this
                importlib.import_module(name)
    sys.exit(0 if compile_deferred(end_with_parent) else 1)

"""Compiles kernels of modules into the cache: `python -m cairn.cli.compile_kernels MODULE...`.

A command starts it when the cache lacks a kernel of the modules that it imports: a compiler keeps
about 200 MiB, which the command then does not have.
"""

from __future__ import annotations

import importlib
import sys
from contextlib import suppress

from cairn.system.compilation import compile_deferred, deferred_compilation


def main() -> None:
    """Import the modules, and compile all kernels of these and of what they import."""
    with deferred_compilation():
        for name in sys.argv[1:]:
            with suppress(Exception):  # the command imports it as well, and reports this
                importlib.import_module(name)
    sys.exit(0 if compile_deferred() else 1)


if __name__ == "__main__":
    main()

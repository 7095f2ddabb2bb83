"""`python -m tests.hardware [pytest's arguments]`: runs the guest's tests in a virtual machine."""

import os
import sys
import time
from pathlib import Path

import platformdirs

from tests.hardware.kernel import Kernel
from tests.hardware.machine import run_in_guest
from tests.hardware.needs import CannotRun, meet

_TESTS = "tests/hardware/guest"
_LIMIT_S = 600.0


def main() -> int:
    """Run the tests; their exit status, or 1 if they cannot be run.

    Continuous integration (`CI=true`) installs what is missing; if it cannot, they are skipped.
    """
    in_ci = os.environ.get("CI") == "true"
    began = time.monotonic()
    cache = platformdirs.user_cache_path("cairn") / "hardware-tests"
    try:
        meet(install=in_ci)
        kernel = Kernel(cache)
    except CannotRun as reason:
        print(f"hardware tests {'SKIPPED' if in_ci else 'cannot run'}: {reason}", flush=True)
        return 0 if in_ci else 1
    print(f"hardware tests: booting Linux {kernel.release} in a virtual machine", flush=True)
    log = cache / "kernel.log"
    command = [sys.executable, "-m", "pytest", *_options(), *(sys.argv[1:] or [_TESTS])]
    try:
        status = run_in_guest(kernel, command, log, _LIMIT_S)
    except CannotRun as reason:
        print(f"hardware tests FAILED: {reason}\n{_end_of(log)}", flush=True)
        return 1
    took = time.monotonic() - began
    print(f"hardware tests {'FAILED' if status else 'passed'} in {took:.0f} s; the kernel: {log}")
    return status


def _options() -> list[str]:
    """Without what the guest's tests do not need: loading it would take longer than they do."""
    unneeded = ("cacheprovider", "xdist", "hypothesispytest")
    colour = "yes" if sys.stdout.isatty() else "no"
    options = [f"--color={colour}", f"--confcutdir={_TESTS}"]
    return [*options, *(word for name in unneeded for word in ("-p", f"no:{name}"))]


def _end_of(log: Path) -> str:
    if not log.exists():
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "the kernel's last lines:\n" + "\n".join(f"  {line}" for line in lines[-15:])


if __name__ == "__main__":
    sys.exit(main())

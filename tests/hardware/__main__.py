"""`python -m tests.hardware [pytest's arguments]`: runs the guest's tests in a virtual machine.

With `--booted` those of the systemd unit, with systemd as the guest's init: this takes minutes on
an otherwise idle machine.
"""

import os
import sys
import time
from pathlib import Path

from cairn.system.user_folders import cache_folder
from tests.hardware.kernel import Kernel
from tests.hardware.machine import run_in_guest
from tests.hardware.needs import CannotRun, meet

_TESTS = "tests/hardware/guest"
_BOOTED_TESTS = "tests/hardware/booted"
_LIMIT_S = 900.0
_BOOTED_LIMIT_S = 1800.0


def main() -> int:
    """Run the tests; their exit status, or 1 if they cannot be run.

    Continuous integration (`CI=true`) installs what is missing; if it cannot, they are skipped.
    """
    in_ci = os.environ.get("CI") == "true"
    began = time.monotonic()
    cache = cache_folder("cairn") / "hardware-tests"
    try:
        meet(install=in_ci)
        kernel = Kernel(cache)
    except CannotRun as reason:
        print(f"hardware tests {'SKIPPED' if in_ci else 'cannot run'}: {reason}", flush=True)
        return 0 if in_ci else 1
    print(f"hardware tests: booting Linux {kernel.release} in a virtual machine", flush=True)
    log = cache / "kernel.log"
    booted = "--booted" in sys.argv
    arguments = [argument for argument in sys.argv[1:] if argument != "--booted"]
    tests = _BOOTED_TESTS if booted else _TESTS
    command = [sys.executable, "-m", "pytest", *_options(tests), *(arguments or [tests])]
    limit_s = _BOOTED_LIMIT_S if booted else _LIMIT_S
    try:
        status = run_in_guest(kernel, command, log, limit_s, booted=booted)
    except CannotRun as reason:
        print(f"hardware tests FAILED: {reason}\n{_end_of(log)}", flush=True)
        return 1
    took = time.monotonic() - began
    print(f"hardware tests {'FAILED' if status else 'passed'} in {took:.0f} s; the kernel: {log}")
    return status


def _options(folder: str) -> list[str]:
    """Return options that disable unneeded plugins: loading them takes longer than the tests."""
    unneeded = ("cacheprovider", "xdist", "hypothesispytest")
    color = "yes" if sys.stdout.isatty() else "no"
    options = [f"--color={color}", f"--confcutdir={folder}"]
    return [*options, *(word for name in unneeded for word in ("-p", f"no:{name}"))]


def _end_of(log: Path) -> str:
    if not log.exists():
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "the kernel's last lines:\n" + "\n".join(f"  {line}" for line in lines[-15:])


if __name__ == "__main__":
    sys.exit(main())

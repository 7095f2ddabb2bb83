"""Kernel modules of the guest."""

import subprocess

_LIMIT_S = 60.0


def load(module: str) -> None:
    """Load a kernel module; returns when all its devices have their names in /dev."""
    run("modprobe", module)
    settle()


def settle() -> None:
    """Wait until udev has made all links for the devices that the kernel has reported."""
    run("udevadm", "settle")


def run(*command: str) -> None:
    """Run a command; an `AssertionError` with its output if it fails."""
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=_LIMIT_S)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"

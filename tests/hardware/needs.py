"""The programs that a machine needs to build and run the virtual machine."""

import os
import platform
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

_SYSTEM_FOLDERS = ("/usr/local/sbin", "/usr/sbin", "/sbin")  # not on a user's path in Debian
_INSTALL_LIMIT_S = 300


class CannotRun(Exception):
    """The virtual machine cannot run here: the reason and the remedy."""


@dataclass(frozen=True)
class Need:
    """A program, and the package of Debian and Ubuntu that contains it."""

    program: str
    package: str


NEEDS = (
    Need("qemu-system-x86_64", "qemu-system-x86"),
    Need("busybox", "busybox-static"),
    Need("cpio", "cpio"),
    Need("modprobe", "kmod"),
    Need("udevadm", "udev"),
    Need("systemctl", "systemd"),
    Need("gcc", "gcc"),
    Need("make", "make"),
)


def meet(*, install: bool) -> None:
    """Ensure that all programs are installed; with `install`, install those that are not.

    Raises `CannotRun` with the command that installs them.
    """
    if platform.machine() != "x86_64":
        raise CannotRun(f"the guest is made for x86_64, and this is {platform.machine()}")
    packages = _missing()
    if not packages:
        return
    command = f"apt-get install -y --no-install-recommends {' '.join(packages)}"
    if not install:
        raise CannotRun(f"not installed: {', '.join(packages)}; install by: sudo {command}")
    if os.geteuid() != 0 or shutil.which("apt-get") is None:
        raise CannotRun(f"not installed: {', '.join(packages)}, and only root on Debian can do it")
    run(["apt-get", "update", "-q"], _INSTALL_LIMIT_S)
    run(command.split(), _INSTALL_LIMIT_S)


def program(name: str) -> str:
    """The path of a program, in a system folder too; raises `CannotRun` if it is missing."""
    path = os.pathsep.join([os.environ.get("PATH", ""), *_SYSTEM_FOLDERS])
    found = shutil.which(name, path=path)
    if found is None:
        raise CannotRun(f"the program {name} is missing")
    return found


def run(command: list[str], limit_s: float, *, folder: Path | None = None) -> str:
    """Run a command to its end, and return what it printed.

    Raises `CannotRun` with the end of its output if it fails, or does not end within the limit.
    """
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=limit_s,
            env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"},
        )
    except subprocess.TimeoutExpired as error:
        raise CannotRun(f"`{' '.join(command)}` does not end within {limit_s:g} s") from error
    except OSError as error:
        raise CannotRun(f"`{' '.join(command)}` cannot be run: {error.strerror}") from error
    if done.returncode != 0:
        end = "\n".join(done.stdout.splitlines()[-8:])
        raise CannotRun(f"`{' '.join(command)}` failed with {done.returncode}:\n{end}")
    return done.stdout


def _missing() -> list[str]:
    """Packages that have to be installed."""
    packages = []
    for need in NEEDS:
        try:
            found = program(need.program)
        except CannotRun:
            packages.append(need.package)
            continue
        if need.program == "busybox" and _is_dynamic(Path(found)):
            packages.append(need.package)
    return packages


def _is_dynamic(path: Path) -> bool:
    """Whether a program needs libraries, which the guest's first file system does not have."""
    with path.open("rb") as file:
        return b"/ld-linux" in file.read(4096)

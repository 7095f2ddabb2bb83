"""The computer: software versions, kernel, drivers, udev rules, clock, processor, limits, disk."""

from __future__ import annotations

import ctypes
import locale
import os
import platform
import re
import resource
import shutil
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import cairn
from cairn.cli.doctor import Finding
from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError
from cairn.system.extras import PACKAGE, missing_libraries, robot_extras
from cairn.system.files import MANY_FILES
from cairn.system.runtime_folder import VARIABLE, check_private, runtime_folder
from cairn.system.user_folders import state_folder

_SOFTWARE, _TOPIC = "software", "computer"
_LISTED = ("eclipse-zenoh", "numpy", "pydantic", "pyserial")
_OLDEST_PYTHON = (3, 11)
_RULES = "70-cairn.rules"
_RULES_FOLDERS = (
    "etc/udev/rules.d",
    "run/udev/rules.d",
    "usr/local/lib/udev/rules.d",
    "usr/lib/udev/rules.d",
)
_DRIVERS = {
    "cdc_acm": "USB scanners and motor controllers (/dev/ttyACM*)",
    "ftdi_sio": "RS-232 over FTDI adapters (/dev/ttyUSB*)",
    "uvcvideo": "USB cameras (/dev/video*)",
}
_SLOW_CLOCKS = frozenset({"hpet", "acpi_pm", "jiffies"})
_SELF_ADAPTING_DRIVERS = frozenset({"intel_pstate", "amd-pstate", "amd-pstate-epp"})
_LITTLE_SPACE = 1 << 30  # bytes: enough for the report and logs of an hour
_NO_SPACE = 50 << 20
_LONG_PATH = 70  # characters: a socket's path may have 107, and its name needs the rest
_UNSYNCHRONIZED = 5  # TIME_ERROR, adjtimex(2)


def software() -> Iterator[Finding]:
    """Check Python, the packages that Cairn requires, and the locale."""
    python = f"{platform.python_version()} in {sys.prefix}"
    if sys.version_info >= _OLDEST_PYTHON:
        yield Finding(_SOFTWARE, "Python", "ok", python)
    else:
        yield Finding(_SOFTWARE, "Python", "fail", python, "use Python 3.11 or later")
    missing = [name for name in _required_packages() if not _is_installed(name)]
    for name in missing:
        remedy = (
            f"install Cairn again, with its packages: {sys.executable} -m pip install {PACKAGE}"
        )
        yield Finding(_SOFTWARE, name, "fail", "is not installed", remedy)
    listed = [f"{name} {version(name)}" for name in (PACKAGE, *_LISTED) if name not in missing]
    yield Finding(_SOFTWARE, "packages", "ok", ", ".join(listed))
    yield _extras()
    encoding = locale.getpreferredencoding(do_setlocale=False)
    if encoding.upper().replace("-", "") == "UTF8":
        yield Finding(_SOFTWARE, "locale", "ok", encoding)
    else:
        remedy = "set LANG=C.UTF-8; otherwise some names and units are not displayed correctly"
        yield Finding(_SOFTWARE, "locale", "warn", encoding, remedy)


def _extras() -> Finding:
    missing = {extra: missing_libraries(extra) for extra in robot_extras()}
    installed = [extra for extra, names in missing.items() if not names]
    lacks = [f"{extra} lacks {', '.join(names)}" for extra, names in missing.items() if names]
    found = f"installed: {', '.join(installed) or 'none'}"
    # A robot that needs no more is without fault: `cairn check` names what a component needs.
    return Finding(_SOFTWARE, "extras", "ok", "; ".join([found, *lacks]))


def computer(root: Path = Path("/")) -> Iterator[Finding]:
    """Check the computer; `root` is the folder that has `etc`, `lib`, `sys` and `usr`."""
    release = platform.release()
    yield Finding(_TOPIC, "kernel", "ok", f"Linux {release}, {platform.machine()}")
    for name, purpose in _DRIVERS.items():
        yield _driver(root, release, name, purpose)
    yield from _clock(root)
    yield _governor(root)
    yield _open_files()
    yield _runtime_folder()
    yield _disk_space()
    yield _udev_rules(root)


def _driver(root: Path, release: str, name: str, purpose: str) -> Finding:
    subject = f"driver {name}"
    if (root / "sys" / "module" / name).exists():
        return Finding(_TOPIC, subject, "ok", f"loaded; for {purpose}")
    folder = root / "lib" / "modules" / release
    listed = [folder / "modules.builtin", folder / "modules.dep"]
    if not any(file.exists() for file in listed):
        found = f"not loaded, and {folder} does not exist to load it from; for {purpose}"
        remedy = "in a container, load it on the host; otherwise install the kernel's modules"
        return Finding(_TOPIC, subject, "warn", found, remedy)
    if any(f"/{name}.ko" in file.read_text() for file in listed if file.exists()):
        return Finding(_TOPIC, subject, "ok", f"is loaded when a device needs it; for {purpose}")
    remedy = (
        f"install linux-modules-extra-{release} (Ubuntu), or linux-image-amd64 or -arm64 instead "
        "of the cloud kernel (Debian)"
    )
    return Finding(_TOPIC, subject, "warn", f"this kernel does not have it; for {purpose}", remedy)


def _clock(root: Path) -> Iterator[Finding]:
    now = time.time()
    text = f"{datetime.fromtimestamp(now, UTC):%Y-%m-%d %H:%M:%S} UTC"
    installed = Path(cairn.__file__).stat().st_mtime
    remedy = (
        "sudo timedatectl set-ntp true, or install chrony, which several machines of a robot need: "
        "docs/how-to/machines.md has its settings; stamps are compared with this clock"
    )
    if now < installed:
        found = f"{text}, which is before Cairn was installed"
        yield Finding(_TOPIC, "clock", "fail", found, remedy)
    elif _is_synchronized():
        yield Finding(_TOPIC, "clock", "ok", f"{text}, synchronized")
    else:
        found = f"{text}, not synchronized: it may jump while the robot runs"
        yield Finding(_TOPIC, "clock", "warn", found, remedy)
    source = root / "sys/devices/system/clocksource/clocksource0/current_clocksource"
    name = source.read_text().strip() if source.exists() else "unknown"
    if name in _SLOW_CLOCKS:
        remedy = "search the kernel's log for `clocksource`: each reading takes microseconds"
        yield Finding(_TOPIC, "clock source", "warn", f"{name}, which is slow", remedy)
    else:
        yield Finding(_TOPIC, "clock source", "ok", name)


def _is_synchronized() -> bool:
    timex = ctypes.create_string_buffer(512)  # larger than any; all 0: only reads
    return int(ctypes.CDLL(None).adjtimex(timex)) != _UNSYNCHRONIZED


def _governor(root: Path) -> Finding:
    cores = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq"))
    subject, count = "processor", f"{os.cpu_count()} cores"
    if not cores:
        return Finding(_TOPIC, subject, "ok", f"{count}, of constant speed")
    governors = {(core / "scaling_governor").read_text().strip() for core in cores}
    drivers = {(core / "scaling_driver").read_text().strip() for core in cores}
    found = f"{count}, governor {', '.join(sorted(governors))}"
    if "powersave" in governors and not drivers <= _SELF_ADAPTING_DRIVERS:
        remedy = "sudo cpupower frequency-set -g schedutil; now it stays at its lowest speed"
        return Finding(_TOPIC, subject, "warn", found, remedy)
    return Finding(_TOPIC, subject, "ok", found)


def _open_files() -> Finding:
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    many = "unlimited" if soft == resource.RLIM_INFINITY else f"{soft:,}"
    if soft != resource.RLIM_INFINITY and soft < MANY_FILES:
        return Finding(_TOPIC, "open files", "warn", f"at most {many}", f"ulimit -n {MANY_FILES}")
    return Finding(_TOPIC, "open files", "ok", f"at most {many}")


def _runtime_folder() -> Finding:
    folder = runtime_folder()
    subject = "folder of sockets"
    above = next(one for one in (folder, *folder.parents) if one.exists())
    if not os.access(above, os.W_OK | os.X_OK):
        remedy = f"set {VARIABLE} to a folder that this user may write"
        return Finding(_TOPIC, subject, "fail", f"{folder} cannot be written", remedy)
    if len(os.fsencode(folder)) > _LONG_PATH:
        remedy = f"set {VARIABLE} to a folder with a shorter path"
        return Finding(_TOPIC, subject, "fail", f"{folder} is too long for sockets", remedy)
    try:
        if folder.is_symlink() or folder.exists():
            check_private(folder)
    except CairnError as error:
        found, _, remedy = str(error).partition("; ")
        return Finding(_TOPIC, subject, "fail", found, remedy)
    return Finding(_TOPIC, subject, "ok", str(folder))


def _disk_space() -> Finding:
    folder = state_folder("cairn")
    above = next(one for one in (folder, *folder.parents) if one.exists())
    subject = "folder of reports"
    if not os.access(above, os.W_OK | os.X_OK):
        remedy = "name another one with `cairn up --report`, or correct its permissions"
        return Finding(_TOPIC, subject, "fail", f"{folder} cannot be written", remedy)
    free = shutil.disk_usage(above).free
    found = f"{folder}, {free / (1 << 30):,.1f} GiB free"
    if free < _LITTLE_SPACE:
        remedy = "delete files, or name another folder with `cairn up --report`"
        return Finding(_TOPIC, subject, "fail" if free < _NO_SPACE else "warn", found, remedy)
    return Finding(_TOPIC, subject, "ok", found)


def _udev_rules(root: Path) -> Finding:
    files = [root / folder / _RULES for folder in _RULES_FOLDERS]
    installed = next((str(file) for file in files if file.exists()), "")
    if installed:
        return Finding(_TOPIC, "udev rules", "ok", installed)
    remedy = (
        f"sudo cp {FOLDER}/robot/{_RULES} /etc/udev/rules.d/ && sudo udevadm control --reload && "
        "sudo udevadm trigger"
    )
    found = "not installed: without them the robot's devices have no stable names and permissions"
    return Finding(_TOPIC, "udev rules", "warn", found, remedy)


def _required_packages() -> list[str]:
    lines = [line for line in requires(PACKAGE) or () if "extra ==" not in line]
    return [re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in lines]


def _is_installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True

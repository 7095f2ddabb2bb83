"""The computer itself: kernel, drivers, clock, processor, limits, and room for reports."""

from __future__ import annotations

import ctypes
import os
import platform
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import platformdirs

import cairn
from cairn.cli.doctor.finding import Finding

_TOPIC = "computer"
_DRIVERS = {
    "cdc_acm": "USB scanners and motor controllers (/dev/ttyACM*)",
    "ftdi_sio": "RS-232 over FTDI adapters (/dev/ttyUSB*)",
    "uvcvideo": "USB cameras (/dev/video*)",
}
_SLOW_CLOCKS = frozenset({"hpet", "acpi_pm", "jiffies"})
_ADAPTS_ITSELF = frozenset({"intel_pstate", "amd-pstate", "amd-pstate-epp"})
_FEW_FILES = 1024
_LITTLE_ROOM = 1 << 30  # bytes: an hour's report with its logs fits well
_NO_ROOM = 50 << 20
_LONG_PATH = 70  # characters: a socket's path may have 107, and its name needs the others
_UNSYNCHRONISED = 5  # TIME_ERROR, adjtimex(2)


def computer(root: Path = Path("/")) -> Iterator[Finding]:
    """All of it; `root` is the folder that has `sys` and `lib`."""
    release = platform.release()
    yield Finding(_TOPIC, "kernel", "ok", f"Linux {release}, {platform.machine()}")
    for name, purpose in _DRIVERS.items():
        yield _driver(root, release, name, purpose)
    yield from _clock(root)
    yield _governor(root)
    yield _open_files()
    yield _runtime_folder()
    yield _room()


def _driver(root: Path, release: str, name: str, purpose: str) -> Finding:
    subject = f"driver {name}"
    if (root / "sys" / "module" / name).exists():
        return Finding(_TOPIC, subject, "ok", f"loaded; for {purpose}")
    folder = root / "lib" / "modules" / release
    listed = [folder / "modules.builtin", folder / "modules.dep"]
    if not any(file.exists() for file in listed):
        found = f"not loaded, and {folder} is not here to load it from; for {purpose}"
        remedy = "in a container, load it on the host; else install the kernel's modules"
        return Finding(_TOPIC, subject, "warn", found, remedy)
    if any(f"/{name}.ko" in file.read_text() for file in listed if file.exists()):
        return Finding(_TOPIC, subject, "ok", f"is loaded when a device needs it; for {purpose}")
    remedy = (
        f"install linux-modules-extra-{release} (Ubuntu), or linux-image-amd64 or -arm64 instead "
        "of the cloud kernel (Debian)"
    )
    return Finding(_TOPIC, subject, "warn", f"this kernel has none; for {purpose}", remedy)


def _clock(root: Path) -> Iterator[Finding]:
    now = time.time()
    told = f"{datetime.fromtimestamp(now, UTC):%Y-%m-%d %H:%M:%S} UTC"
    installed = Path(cairn.__file__).stat().st_mtime
    remedy = "sudo timedatectl set-ntp true, or install chrony; stamps are compared by this clock"
    if now < installed:
        found = f"{told}, which is before Cairn was installed"
        yield Finding(_TOPIC, "clock", "fail", found, remedy)
    elif _is_synchronized():
        yield Finding(_TOPIC, "clock", "ok", f"{told}, synchronized")
    else:
        found = f"{told}, not synchronized: it may step while the robot runs"
        yield Finding(_TOPIC, "clock", "warn", found, remedy)
    source = root / "sys/devices/system/clocksource/clocksource0/current_clocksource"
    name = source.read_text().strip() if source.exists() else "unknown"
    if name in _SLOW_CLOCKS:
        remedy = "look for `clocksource` in the kernel's log: each reading takes microseconds"
        yield Finding(_TOPIC, "clock source", "warn", f"{name}, a slow one", remedy)
    else:
        yield Finding(_TOPIC, "clock source", "ok", name)


def _is_synchronized() -> bool:
    timex = ctypes.create_string_buffer(512)  # larger than any; all 0: only asks, sets nothing
    return int(ctypes.CDLL(None).adjtimex(timex)) != _UNSYNCHRONISED


def _governor(root: Path) -> Finding:
    cores = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq"))
    subject, count = "processor", f"{os.cpu_count()} cores"
    if not cores:
        return Finding(_TOPIC, subject, "ok", f"{count}, of a speed that does not change")
    governors = {(core / "scaling_governor").read_text().strip() for core in cores}
    drivers = {(core / "scaling_driver").read_text().strip() for core in cores}
    found = f"{count}, governor {', '.join(sorted(governors))}"
    if "powersave" in governors and not drivers <= _ADAPTS_ITSELF:
        remedy = "sudo cpupower frequency-set -g schedutil: now it stays at its lowest speed"
        return Finding(_TOPIC, subject, "warn", found, remedy)
    return Finding(_TOPIC, subject, "ok", found)


def _open_files() -> Finding:
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    many = "unlimited" if soft == resource.RLIM_INFINITY else f"{soft:,}"
    if soft != resource.RLIM_INFINITY and soft < _FEW_FILES:
        return Finding(_TOPIC, "open files", "warn", f"at most {many}", f"ulimit -n {_FEW_FILES}")
    return Finding(_TOPIC, "open files", "ok", f"at most {many}")


def _runtime_folder() -> Finding:
    folder = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    subject = "sockets' folder"
    if not os.access(folder, os.W_OK | os.X_OK):
        remedy = "set XDG_RUNTIME_DIR to a folder of this user's"
        return Finding(_TOPIC, subject, "fail", f"{folder} cannot be written", remedy)
    if len(folder) > _LONG_PATH:
        remedy = "set XDG_RUNTIME_DIR to one with a shorter path"
        return Finding(_TOPIC, subject, "fail", f"{folder} is too long for sockets", remedy)
    return Finding(_TOPIC, subject, "ok", folder)


def _room() -> Finding:
    folder = platformdirs.user_state_path("cairn")
    above = next(one for one in (folder, *folder.parents) if one.exists())
    subject = "reports' folder"
    if not os.access(above, os.W_OK | os.X_OK):
        remedy = "give `cairn up` another one by --report, or correct its rights"
        return Finding(_TOPIC, subject, "fail", f"{folder} cannot be written", remedy)
    free = shutil.disk_usage(above).free
    found = f"{folder}, {free / (1 << 30):,.1f} GiB free"
    if free < _LITTLE_ROOM:
        remedy = "make room, or give `cairn up` another folder by --report"
        return Finding(_TOPIC, subject, "fail" if free < _NO_ROOM else "warn", found, remedy)
    return Finding(_TOPIC, subject, "ok", found)

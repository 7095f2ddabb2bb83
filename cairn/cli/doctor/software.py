"""Versions of what Cairn stands on, and the language of the terminal."""

from __future__ import annotations

import locale
import platform
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version

from cairn.cli.doctor.finding import Finding

_TOPIC = "software"
_PACKAGE = "cairn-robotics"
_TOLD = ("eclipse-zenoh", "numpy", "opencv-python-headless", "pydantic", "pyserial")
_OLDEST = (3, 11)


def software() -> Iterator[Finding]:
    """Python, the packages that Cairn requires, and the locale."""
    where = f"{platform.python_version()} in {sys.prefix}"
    if sys.version_info >= _OLDEST:
        yield Finding(_TOPIC, "Python", "ok", where)
    else:
        yield Finding(_TOPIC, "Python", "fail", where, "use Python 3.11 or later")
    yield from _packages()
    encoding = locale.getpreferredencoding(do_setlocale=False)
    if encoding.upper().replace("-", "") == "UTF8":
        yield Finding(_TOPIC, "locale", "ok", encoding)
    else:
        remedy = "set LANG=C.UTF-8, or names and units are not shown as they are"
        yield Finding(_TOPIC, "locale", "warn", encoding, remedy)


def _packages() -> Iterator[Finding]:
    missing = [name for name in _required() if not _installed(name)]
    for name in missing:
        remedy = f"reinstall Cairn, which brings it: {sys.executable} -m pip install {_PACKAGE}"
        yield Finding(_TOPIC, name, "fail", "is not installed", remedy)
    told = [f"{name} {version(name)}" for name in (_PACKAGE, *_TOLD) if name not in missing]
    yield Finding(_TOPIC, "packages", "ok", ", ".join(told))


def _required() -> list[str]:
    """Names of the packages that Cairn cannot do without."""
    lines = [line for line in requires(_PACKAGE) or () if "extra ==" not in line]
    return [re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0] for line in lines]


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True

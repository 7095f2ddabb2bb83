"""THIRD_PARTY.md: the packages that Cairn needs at run time, with version, license and libraries.

`python -m tests.packaging.third_party` writes it from the lock file and the installed packages.
Where their metadata name no license, or not as SPDX, the tables below do.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
NOTICES = ROOT / "THIRD_PARTY.md"
LOCK = ROOT / "requirements" / "dev.txt"
OLDEST_PYTHON = (3, 11)
CAIRN = "cairn-robotics"

LICENSES = {
    "apsw": "any license that the OSI approves",
    "contourpy": "BSD-3-Clause",
    "cycler": "BSD-3-Clause",
    "eclipse-zenoh": "EPL-2.0 OR Apache-2.0",
    "fonttools": "MIT",
    "gtsam": "BSD-2-Clause",
    "h11": "MIT",
    "kiwisolver": "BSD-3-Clause",
    "lz4": "BSD-3-Clause",
    "markdown-it-py": "MIT",
    "matplotlib": "Matplotlib license (like PSF-2.0)",
    "mcap": "MIT",
    "mdurl": "MIT",
    "numba": "BSD-2-Clause",
    "opencv-python-headless": "Apache-2.0",
    "plotext": "MIT",
    "pluggy": "MIT",
    "psutil": "BSD-3-Clause",
    "pyserial": "BSD-3-Clause",
    "pyyaml": "MIT",
    "rich": "MIT",
    "ruamel-yaml": "MIT",
    "scipy": "BSD-3-Clause",
    "setproctitle": "BSD-3-Clause",
    "shellingham": "ISC",
    "tzdata": "Apache-2.0",
    "xxhash": "BSD-2-Clause",
}
"""Licenses of packages whose metadata have no SPDX expression, from their license files."""


class Library(NamedTuple):
    """A shared library in a wheel: its project and license."""

    project: str
    license: str


_GCC = "GPL-3.0-or-later WITH GCC-exception-3.1"
LIBRARIES = {
    r"libav(codec|format|util)|libsw(resample|scale)": Library("FFmpeg", "LGPL-2.1-or-later"),
    r"libgeos(_c)?": Library("GEOS", "LGPL-2.1-or-later"),
    r"libquadmath": Library("GCC libquadmath", "LGPL-2.1-or-later"),
    r"libgfortran": Library("GCC libgfortran", _GCC),
    r"libgcc_s": Library("GCC libgcc", _GCC),
    r"lib(scipy_)?openblas\w*": Library("OpenBLAS", "BSD-3-Clause"),
    r"lib(crypto|ssl)": Library("OpenSSL", "OpenSSL or Apache-2.0, by its version"),
    r"libboost_\w+": Library("Boost", "BSL-1.0"),
    r"libcephes": Library("Cephes", "MIT"),
    r"libgtsam(_unstable)?": Library("GTSAM", "BSD-2-Clause"),
    r"libmetis": Library("METIS", "Apache-2.0"),
    r"libaom": Library("libaom", "BSD-2-Clause"),
    r"libavif": Library("libavif", "BSD-2-Clause"),
    r"libdrm": Library("libdrm", "MIT"),
    r"libvpx": Library("libvpx", "BSD-3-Clause"),
    r"libpng16": Library("libpng", "libpng-2.0"),
    r"lib(Xau|xcb)": Library("X.Org", "MIT"),
    r"libbrotli(common|dec)": Library("Brotli", "MIT"),
    r"libfreetype": Library("FreeType", "FTL"),
    r"libharfbuzz": Library("HarfBuzz", "MIT"),
    r"libjpeg": Library("libjpeg-turbo", "IJG AND BSD-3-Clause"),
    r"liblcms2": Library("Little CMS", "MIT"),
    r"liblzma": Library("XZ Utils", "0BSD"),
    r"libopenjp2": Library("OpenJPEG", "BSD-2-Clause"),
    r"libsharpyuv|libwebp(demux|mux)?": Library("libwebp", "BSD-3-Clause"),
    r"libtiff": Library("LibTIFF", "libtiff"),
    r"libz": Library("zlib", "Zlib"),
    r"libbz2": Library("bzip2", "bzip2-1.0.6"),
    r"libzstd": Library("Zstandard", "BSD-3-Clause"),
    r"libsz|libaec": Library("libaec", "BSD-2-Clause"),
}
"""Shared libraries in wheels, by a pattern of their name without version and hash."""

_HEAD = """# Third-party software

Cairn itself is licensed under [Apache-2.0](LICENSE). Code of others is in it only [where the
console's page needs it](#javascript-of-the-consoles-page). The interface definitions of ROS 2 in
`schemas` are under Apache-2.0 and BSD-3-Clause: `schemas/SOURCES.md` has their sources, copyright
holders and license texts. Pictures and recordings of others are in `deploy/worlds/textures` and
`deploy/recordings`, each with its source and license in `SOURCE.md`. `pip install` with the extra
`all` adds the packages below from their own wheels. Each wheel brings its license texts in its
folder `*.dist-info`. Development tools are not listed: they are not part of a robot.

This file is generated: `make lock` renews it. The versions are those of `requirements/dev.txt`.

## Packages

| package | version | license | shared libraries in its wheel |
|---|---|---|---|
"""

_LGPL = """
## Libraries under the LGPL

These wheels contain libraries under the GNU Lesser General Public License, as shared objects beside
the package (`site-packages/<package>.libs/`), which you may replace by your own builds:

{lines}

Cairn uses them through the packages named, unchanged, and does not link to them itself. If you
distribute a robot with these packages on it, pass on their license texts, and the sources of these
libraries or an offer for them. OpenCV's headless wheel has no Qt. The LGPL libraries of its other
wheels (Qt, and on macOS libgmp and others) are not used: Cairn runs on Linux only.

## Libraries inside extension modules

Some packages are linked statically with further software, which their license files name: OpenCV
(IPP, libjpeg-turbo, OpenEXR, protobuf, TBB and others: `LICENSE-3RD-PARTY.txt`), llvmlite (LLVM),
eclipse-zenoh and pydantic-core (Rust crates), apsw (SQLite), simplejpeg (libjpeg-turbo), NumPy
and SciPy (`LICENSE.txt`), lz4, xxhash and backports-zstd (the libraries of these names).
"""


_JAVASCRIPT = """
## JavaScript of the console's page

`cairn/console/static/vendor` has these files unchanged, with their license texts, so that the page
needs no internet:

| package of npm | version | license | files |
|---|---|---|---|
| htm | 3.1.1 | Apache-2.0 | `preact-htm.js` (`preact/standalone.module.js`) |
| preact, inside htm's file | 10 | MIT | `preact-htm.js` |
| uplot | 1.6.32 | MIT | `uplot.js` (`dist/uPlot.esm.js`), `uplot.css` (`dist/uPlot.min.css`) |
"""


def run_time_packages(extra: str = "all") -> dict[str, Distribution]:
    """Return the packages that Cairn needs with an extra, "" for none, on this Python.

    Directly or not, by canonical name.
    """
    found: dict[str, Distribution] = {}
    waiting = [CAIRN]
    while waiting:
        name = canonicalize_name(waiting.pop())
        if name not in found:
            found[name] = distribution(name)
            waiting += _requirements(found[name], extra if name == CAIRN else "")
    del found[CAIRN]
    return dict(sorted(found.items()))


def locked_versions() -> dict[str, list[str]]:
    """Return the versions of each package in the lock file; several if they depend on Python's."""
    versions: dict[str, list[str]] = {}
    for line in LOCK.read_text(encoding="utf-8").splitlines():
        if match := re.match(r"([a-z0-9-]+)==([^\s;]+)", line):
            versions.setdefault(match[1], []).append(match[2])
    return versions


def license_of(package: Distribution) -> str:
    """Return the license of a package: by its metadata, else by `LICENSES`; else `KeyError`."""
    name = canonicalize_name(package.metadata["Name"])
    expression = package.metadata.json.get("license_expression")
    return str(expression) if expression else LICENSES[name]


def libraries_of(package: Distribution) -> dict[str, Library]:
    """Return the shared libraries in a package's wheel by name; `KeyError` for an unknown one."""
    return {name: _library(name) for name in sorted(_library_names(package))}


def notices() -> str:
    """Return the text of THIRD_PARTY.md."""
    versions = locked_versions()
    rows, lgpl = [], []
    for name, package in run_time_packages().items():
        projects: dict[Library, list[str]] = {}
        for file, library in libraries_of(package).items():
            projects.setdefault(library, []).append(file)
        shown = "; ".join(f"{one.project} ({one.license})" for one in projects)
        rows.append(f"| {name} | {', '.join(versions[name])} | {license_of(package)} | {shown} |")
        lgpl += [
            f"- **{name}**: {library.project}, {library.license} (`{'`, `'.join(files)}`)"
            for library, files in projects.items()
            if "LGPL" in library.license
        ]
    return _HEAD + "\n".join(rows) + "\n" + _LGPL.format(lines="\n".join(lgpl)) + _JAVASCRIPT


def _requirements(package: Distribution, extra: str) -> Iterator[str]:
    for line in package.requires or ():
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"extra": extra}):
            yield requirement.name


def _library_names(package: Distribution) -> Iterator[str]:
    for file in package.files or ():
        if file.parts[0].endswith(".libs"):
            yield re.split(r"[-.]", file.name, maxsplit=1)[0]


def _library(name: str) -> Library:
    for pattern, library in LIBRARIES.items():
        if re.fullmatch(pattern, name):
            return library
    raise KeyError(name)


if __name__ == "__main__":
    if sys.version_info[:2] != OLDEST_PYTHON:
        sys.exit(
            "third_party: newer Pythons need fewer packages and libraries; use the oldest that is "
            "supported: make lock PYTHON=python3.11 VENV=.venv-3.11"
        )
    NOTICES.write_text(notices(), encoding="utf-8")

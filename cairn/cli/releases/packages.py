"""The packages of a release: Cairn, and those of the plugins that its deployment names.

A package that was installed from a folder, as a source checkout is, becomes a wheel of that folder.
One from an index is installed from there on the machine, in the same version. Cairn has the same
extras there as here.
"""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from cairn.deployment.model import Deployment
from cairn.deployment.plugins import plugin_distribution
from cairn.errors import CairnError
from cairn.system.extras import PACKAGE, installed_extras

_BUILD_LIMIT_S: Final = 600.0


@dataclass(frozen=True)
class Packages:
    """What pip installs on the machine: requirements from its index, and wheels that are copied.

    `cairn` is Cairn with its extras, of whatever version the wheel has, if there is one. `digest`
    names the environment that has them.
    """

    requirements: tuple[str, ...]
    wheels: tuple[Path, ...]
    cairn: str
    no_index: bool

    @property
    def digest(self) -> str:
        """One of the requirements, and of the contents of the wheels."""
        words = sorted([self.cairn, *self.requirements, *map(_wheel_digest, self.wheels)])
        text = "\n".join([*words, "no index" if self.no_index else ""])
        return blake2b(text.encode(), digest_size=8).hexdigest()

    def names(self) -> list[str]:
        """Return the packages with their versions."""
        return sorted([*self.requirements, *("==".join(_parts(one)[:2]) for one in self.wheels)])


def packages_of(
    deployment: Deployment, given: Sequence[Path], folder: Path, *, no_index: bool = False
) -> Packages:
    """Return the packages that a deployment needs; wheels are built into `folder`.

    The `given` wheels replace those of their packages, and others among them are added. Raises
    `CairnError` if a plugin is of no package, or a wheel cannot be made.
    """
    wheels = {_normal(_parts(wheel)[0]): wheel for wheel in given}
    requirements = []
    for name in _names(deployment):
        if name in wheels:
            continue
        source = _source(distribution(name))
        if isinstance(source, str):
            requirements.append(source)
        else:
            wheels[name] = _built(source, folder / name) if source.is_dir() else source
    extras = installed_extras()
    cairn = f"{PACKAGE}[{','.join(extras)}]" if extras else PACKAGE
    return Packages(tuple(requirements), tuple(wheels.values()), cairn, no_index)


def _names(deployment: Deployment) -> Iterable[str]:
    names = {PACKAGE: None}
    for plugin in dict.fromkeys(member.spec.plugin for member in deployment.members()):
        found = plugin_distribution(plugin)
        if found is None:
            raise CairnError(
                f"plugin {plugin} is of no installed package, so it cannot be copied; put its "
                "module into a package (`cairn init`), and install that"
            )
        names[_normal(found.metadata["Name"])] = None
    return names


def _source(found: Distribution) -> Path | str:
    """Return the folder or wheel that a package was installed from, else its requirement."""
    name, direct = found.metadata["Name"], found.read_text("direct_url.json")
    if direct is None:
        return f"{name}=={found.version}"
    url = urlsplit(json.loads(direct)["url"])
    path = Path(unquote(url.path))
    if url.scheme == "file" and (path.is_dir() or (path.is_file() and path.suffix == ".whl")):
        return path
    raise CairnError(
        f"package {name} was installed from {url.geturl()}, which cannot be copied; give its wheel "
        "with --wheel"
    )


def _built(project: Path, folder: Path) -> Path:
    """Return the wheel of a project, built into a folder; raises `CairnError`."""
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir"]
    command += [str(folder), *(["--no-build-isolation"] if _has_backend(project) else [])]
    try:
        done = subprocess.run(
            [*command, str(project)], stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=_BUILD_LIMIT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise CairnError(f"{project}: no wheel within {_BUILD_LIMIT_S:g} s") from error
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or len(wheels) != 1:
        reason = (done.stderr or done.stdout).strip()[-2000:]
        raise CairnError(f"{project}: no wheel could be built; give one with --wheel: {reason}")
    return wheels[0]


def _has_backend(project: Path) -> bool:
    """Return whether what builds a project is installed, so that nothing has to be downloaded."""
    try:
        text = (project / "pyproject.toml").read_text(encoding="utf-8")
        described: dict[str, Any] = tomllib.loads(text)
    except (OSError, ValueError):
        return False  # pip reports what is wrong
    backend = str(described.get("build-system", {}).get("build-backend", ""))
    module = re.split("[.:]", backend)[0]
    return bool(module) and importlib.util.find_spec(module) is not None


def _parts(wheel: Path) -> list[str]:
    """Return the parts of a wheel's name: package, version, tags; raises `CairnError`."""
    parts = wheel.name.removesuffix(".whl").split("-")
    if wheel.suffix != ".whl" or len(parts) < 5 or not wheel.is_file():
        raise CairnError(f"{wheel}: it is not a wheel; give a file NAME-VERSION-TAGS.whl")
    return parts


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _wheel_digest(wheel: Path) -> str:
    """Return a digest of what a wheel installs, which does not depend on when it was built."""
    try:
        with zipfile.ZipFile(wheel) as archive:
            (record,) = (name for name in archive.namelist() if name.endswith("/RECORD"))
            lines = sorted(archive.read(record).splitlines())
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise CairnError(f"{wheel}: it is not a wheel: {error}; build it again") from error
    return blake2b(b"\n".join([wheel.name.encode(), *lines]), digest_size=16).hexdigest()

"""What a release holds of a deployment: one merged file, and the files that its components read."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

import yaml

from cairn.deployment.load import assemble, merge, read_sources
from cairn.deployment.model import Deployment, Member
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.limits.files import open_regular
from cairn.runtime.input_files import MOST_FILES, file_digest, files_read_at
from cairn.runtime.parameters import MarkedParameter, ReadPathMark, marked_parameters
from cairn.system.files import explained

FILES: Final = "files"
"""Folder of a release with the files that components read, each below its path on this computer."""

_PRIVATE_KEY: Final = b"PRIVATE KEY-----"
_SEARCHED_BYTES: Final = 1 << 16


@dataclass(frozen=True)
class Contents:
    """A deployment for one machine: its text, and files by their paths in the release.

    `size` is that of the files [bytes], `digest` one of everything; `notes` name what is left out.
    """

    name: str
    text: str
    files: Mapping[str, Path]
    size: int
    digest: str
    notes: tuple[str, ...] = field(default=())


def release_contents(
    file: Path, overlays: Sequence[Path], sets: Sequence[str], machine: str = ""
) -> tuple[Deployment, Contents]:
    """Return a deployment, and what a release of it holds for one of its machines.

    Overlays and `--set`s become part of the one file. The paths that components of that machine
    read are replaced by those of the copies; `${here}` is the folder of the release. Raises
    `CairnError` if the deployment has problems, or a file cannot be copied.
    """
    sources = read_sources(file, overlays)
    deployment = assemble(sources, sets)
    document = merge(sources, sets).plain()
    collected = _Collected()
    for member in deployment.members():
        if machine and deployment.machine_of(member.name) != machine:
            continue
        for read in _read_paths(member):
            copy = collected.add(Path(read.value), f"{member.name}.{read.name}")
            if copy and (parameters := _parameters(document, member, read)) is not None:
                parameters[read.name.rpartition(".")[2]] = copy
    if deployment.robot_description is not None:
        path = Path(deployment.robot_description)
        copy = collected.add(path, "robot_description")
        document["robot_description"] = copy or document["robot_description"]
    notes = [*collected.notes, *_secrets_left_out(deployment)]
    origin = ", ".join([file.name, *(one.name for one in overlays), *(f"--set {s}" for s in sets)])
    head = f"# Written by `cairn deploy push` from: {' '.join(origin.split())}\n"
    body = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=100)
    text, files = head + body, collected.files
    digest = blake2b(f"{deployment.robot.name}\n{machine}\n{text}".encode(), digest_size=16)
    size = 0
    for name, path in sorted(files.items()):
        with explained(f"{path}: cannot be copied"):
            digest.update(f"{name}\n{file_digest(path)}\n".encode())
            size += path.stat().st_size
    name = f"{deployment.robot.name}.yaml"
    return deployment, Contents(name, text, files, size, digest.hexdigest(), tuple(notes))


class _Collected:
    """The files of a release, and remarks on those that are not in it."""

    def __init__(self) -> None:
        self.files: dict[str, Path] = {}
        self.notes: list[str] = []

    def add(self, path: Path, named_by: str) -> str:
        """Add what is at a path; return the path of the copy, "" if there is nothing."""
        path = Path(os.path.abspath(path))
        if not path.exists():
            self.notes.append(f"{named_by}: {path} is not on this computer, and not copied")
            return ""
        found = list(files_read_at(path))
        if len(found) >= MOST_FILES:
            raise CairnError(
                f"{named_by}: {path} has {MOST_FILES:,} files or more; name a smaller folder"
            )
        for file in found:
            real = Path(os.path.abspath(file))
            _check_no_secret(real, named_by)
            self.files[_copy_of(real)] = real
        return "${here}/" + _copy_of(path).replace("${", "$${")


def _read_paths(member: Member) -> Iterator[MarkedParameter[ReadPathMark]]:
    config = load_plugin(member.spec.plugin).config_class()
    yield from marked_parameters(config.model_validate(member.spec.parameters), ReadPathMark)


def _parameters(
    document: Any, member: Member, read: MarkedParameter[ReadPathMark]
) -> dict[str, Any] | None:
    """Return the mapping of a document that holds a parameter; None for a generated component."""
    place = document
    for step in member.key.split("."):
        if step not in place:
            return None
        place = place[step]
    for step in ("parameters", *read.name.split(".")[:-1]):
        if place.get(step) is None:
            place[step] = {}
        place = place[step]
        if not isinstance(place, dict):
            raise CairnError(
                f"{member.name}.{read.name}: {step} refers to a setting as a whole, so the file "
                "cannot be replaced by its copy; write its keys, each with a reference of its own"
            )
    found: dict[str, Any] = place
    return found


def _copy_of(path: Path) -> str:
    return str(Path(FILES, *path.parts[1:]))


def _check_no_secret(file: Path, named_by: str) -> None:
    """Raise `CairnError` if a file has a private key."""
    with explained(f"{named_by}: {file}"), open_regular(file) as stream:
        start = stream.read(_SEARCHED_BYTES)
    if _PRIVATE_KEY in start:
        raise CairnError(
            f"{named_by}: {file} has a private key, which is never copied; move it to a folder "
            "that no component reads"
        )


def _secrets_left_out(deployment: Deployment) -> Iterator[str]:
    bus = deployment.bus
    tls = bus.tls
    named = {
        "bus.tls.certificate": tls and tls.certificate,
        "bus.tls.key": tls and tls.key,
        "bus.tls.ca": tls and tls.ca,
        "bus.password_file": bus.password_file,
    }
    for name, user in bus.users.items():
        named[f"bus.users.{name}.password_file"] = user.password_file
    for key, path in named.items():
        if path:
            yield f"{key}: {path} is never copied; the machine needs its own"

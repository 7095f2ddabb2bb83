"""The deployments, overlays and worlds that Cairn ships, found by name."""

from __future__ import annotations

import re
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from cairn.errors import CairnError

FOLDER = (Path(__file__).parents[1] / "deploy").resolve()
"""Where they lie: part of the installed package, so nothing is written here."""


class Shipped(NamedTuple):
    """A shipped deployment, or an overlay, which replaces values of a deployment."""

    name: str
    is_overlay: bool
    summary: str
    file: Path


def shipped() -> list[Shipped]:
    """Return the shipped deployments, then the overlays, by name."""
    found = []
    for file in sorted(FOLDER.glob("*.yaml")):
        text = file.read_text(encoding="utf-8")
        is_overlay = not re.search("^cairn:", text, re.MULTILINE)
        found.append(Shipped(file.stem, is_overlay, _summary(text), file))
    return sorted(found, key=lambda one: one.is_overlay)


def deployment_file(name: str) -> Path:
    """Return the file of that path, or else the shipped deployment or overlay of that name.

    Raises `CairnError` if `name` is not a path and nothing of that name is shipped.
    """
    known = [f"{one.name} (overlay)" if one.is_overlay else one.name for one in shipped()]
    return file_or_shipped(name, FOLDER, "deployment", known)


def world_file(name: str) -> Path:
    """Return the file of that path, or else the shipped world of that name.

    Raises `CairnError` if `name` is not a path and nothing of that name is shipped.
    """
    folder = FOLDER / "worlds"
    return file_or_shipped(
        name, folder, "world", sorted(file.stem for file in folder.glob("*.yaml"))
    )


def file_or_shipped(name: str, folder: Path, kind: str, known: list[str]) -> Path:
    """Return the file of that path, or else that of that name in a folder of shipped files.

    Raises `CairnError`, with the `known` names, if `name` is neither.
    """
    file, candidate = Path(name), folder / f"{name}.yaml"
    is_path = file.name != name or file.suffix
    if is_path or (file.exists() and not file.is_dir()):
        return file  # where it does not exist, the reader reports the path
    if candidate.is_file():  # even beside a folder of that name, such as a report
        return candidate
    if file.exists():
        return file
    close = get_close_matches(name, [one.partition(" ")[0] for one in known], n=2)
    guess = f"did you mean {' or '.join(close)}? Give" if close else "give"
    raise CairnError(
        f"there is neither a file {name} nor a shipped {kind} of that name; {guess} the path of a "
        f"file, or one of: {', '.join(known)}"
    )


def _summary(text: str) -> str:
    """Return the first sentence of a file's leading comment."""
    lines = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        words = line.removeprefix("#").strip()
        if not words.startswith("yaml-language-server"):
            lines.append(words)
    return re.split(r"\.(?:\s|$)", " ".join(lines).strip(), maxsplit=1)[0]

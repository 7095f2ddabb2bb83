"""The files that a component reads: those that its parameters name, and those named in these.

A recording keeps them as attachments, by their digests, so that a re-run has them as they were.
"""

import re
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Final

from pydantic import BaseModel

from cairn.limits.files import open_regular
from cairn.runtime.parameters import Config

MOST_FILES: Final = 2_000
"""Files of one component; of a folder with more, the rest is missing in a re-run."""
LONGEST_FILE: Final = 256 << 20
"""Longer files are not kept [bytes]."""

_SHORT_BYTES: Final = 16_384
_LONGEST_TEXT: Final = 1 << 20  # of a file that is searched for names of others [bytes]
_SQLITE_PARTS: Final = ("-wal", "-shm")
_TEXT_SUFFIXES: Final = frozenset({".yaml", ".yml", ".json", ".toml", ".txt", ".csv", ".xml"})
_WORD = re.compile(r"[^\s\"'\[\]{},:;=<>|]+")


@dataclass(frozen=True)
class InputFile:
    """A file as it was: its path, its size [bytes] and its digest, "" if it is too long.

    `content` [base64] is that of a short file that a parameter names: it may be the component's own
    state, which changes during the run, so that it differs when the component is restarted.
    """

    path: str
    size: int
    digest: str
    content: str = ""


def path_parameters(config: Config) -> dict[str, Path]:
    """Return the absolute paths of all parameters that are one, by dotted name."""
    return dict(_paths(config, ""))


def input_files(config: Config) -> list[InputFile]:
    """Return the existing regular files that a component with these parameters may read.

    Those are the files that parameters name, all files in folders that they name, the files that
    small text files among these name, relative to their folder, and what SQLite keeps beside a
    database. A file that cannot be read is left out.
    """
    found: dict[Path, None] = {}
    named = path_parameters(config).values()
    for path in named:
        for file in files_read_at(path):
            if len(found) < MOST_FILES:
                found[file] = None
    files = []
    for file in found:
        try:
            size = file.stat().st_size
            if size <= _SHORT_BYTES and file in named:
                content = file.read_bytes()
                text = b64encode(content).decode()
                files.append(InputFile(str(file), len(content), content_digest(content), text))
                continue
            digest = file_digest(file) if size <= LONGEST_FILE else ""
        except OSError:
            continue
        files.append(InputFile(str(file), size, digest))
    return files


def files_read_at(path: Path) -> Iterator[Path]:
    """Yield the files at a path, and those that they name; an unreadable folder has none.

    Of a folder with more, those are 2,000 files.
    """
    try:
        if path.is_file():
            yield path
            yield from sqlite_files(path)
            yield from (other for _, other in named_files(path))
        elif path.is_dir():
            for count, file in enumerate(sorted(path.rglob("*"))):
                if count >= MOST_FILES:
                    return
                if file.is_file():
                    yield file
    except OSError:
        return


def file_digest(file: Path) -> str:
    """Return the digest of a file's content; raises `OSError` if it cannot be read."""
    digest = blake2b(digest_size=16)
    with open_regular(file) as stream:
        while part := stream.read(1 << 20):
            digest.update(part)
    return digest.hexdigest()


def content_digest(content: bytes) -> str:
    """Return the digest of a file with this content."""
    return blake2b(content, digest_size=16).hexdigest()


def _paths(group: BaseModel, prefix: str) -> Iterator[tuple[str, Path]]:
    for name in type(group).model_fields:
        value = getattr(group, name)
        if isinstance(value, BaseModel):
            yield from _paths(value, f"{prefix}{name}.")
        elif isinstance(value, Path):
            yield f"{prefix}{name}", value.absolute()


def sqlite_files(path: Path) -> Iterator[Path]:
    """Yield what SQLite keeps beside a database that is open or was not closed."""
    for part in _SQLITE_PARTS:
        if (beside := path.with_name(path.name + part)).is_file():
            yield beside


def named_files(file: Path) -> Iterator[tuple[str, Path]]:
    """Yield the existing files that a small text file names, relative to its folder, as it does."""
    if file.suffix not in _TEXT_SUFFIXES or file.stat().st_size > _LONGEST_TEXT:
        return
    for word in dict.fromkeys(_WORD.findall(file.read_text(errors="replace"))):
        other = file.parent / word
        if is_name(word) and other != file and other.is_file():
            yield word, Path(other.absolute())


def is_name(word: str) -> bool:
    """Return whether this text may be the name of a file."""
    return "." in word and len(word) < 256

"""A task is one run in lockstep, complete in itself; its result is bytes that can be compared."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any, Final

import lz4.frame

from cairn.limits.compression import RECORD_BYTES, unpack
from cairn.limits.files import megabytes

ROOT: Final = "/cairn-task"
"""Stands for the folder of a run in its deployment and in its result; the worker replaces it."""
RUN: Final = f"{ROOT}/run"
"""The folder into which a run writes: `settings.report` of its deployment."""
LOG: Final = "log.txt"
"""The name of a run's log among the files of its result."""

MOST_INPUT_BYTES: Final = 256 << 20
"""Size of all files that a task may need [bytes]."""
MOST_RESULT_BYTES: Final = RECORD_BYTES
"""Size of all files of a result [bytes]."""

Parameters = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class PackedDeployment:
    """A deployment with the content of the files that it names.

    `document` is JSON; the paths in it begin with `ROOT`. `files` maps the path of each file below
    `ROOT` to the digest of its content, `contents` these to bytes; `folders` exist even if empty.
    `code` has the versions of the code that the deployment runs. `origins` maps folders below
    `ROOT` to those of this computer, for messages; the result does not depend on them.
    """

    document: str
    files: Mapping[str, str]
    folders: tuple[str, ...]
    contents: Mapping[str, bytes]
    code: Mapping[str, str]
    origins: Mapping[str, str]

    def with_origins(self, text: str) -> str:
        """Return a text of a result with the paths of this computer."""
        for packed, origin in self.origins.items():
            text = text.replace(packed, origin)
        return text


@dataclass(frozen=True)
class Task:
    """A run of a deployment in lockstep with a seed; `name` is for messages.

    `outputs` are the files below `RUN` that belong to the result. `parameters` replace those of
    some components, by the components' names.
    """

    name: str
    packed: PackedDeployment
    seed: int
    outputs: tuple[str, ...]
    parameters: Parameters = field(default_factory=dict)

    def payload(self) -> bytes:
        """Return all that a worker needs besides the files' contents; equal tasks, equal bytes."""
        packed = self.packed
        content = {
            "deployment": packed.document,
            "files": dict(packed.files),
            "folders": list(packed.folders),
            "code": dict(packed.code),
            "seed": self.seed,
            "outputs": list(self.outputs),
            "parameters": {name: dict(values) for name, values in self.parameters.items()},
        }
        return json.dumps(content, sort_keys=True).encode()

    @cached_property
    def key(self) -> str:
        """Digest of the task: what the result depends on, and nothing else."""
        return blake2b(self.payload(), digest_size=20).hexdigest()


@dataclass(frozen=True)
class TaskResult:
    """How a run ended, and its files by their names.

    `reason` says why it ended. `error`: the run broke off with an exception, so that the same task
    may end otherwise the next time.
    """

    normal: bool
    success: bool
    reason: str
    files: Mapping[str, bytes]
    error: str = ""

    def encode(self) -> bytes:
        """Return the result as bytes: equal results, equal bytes."""
        names = sorted(self.files)
        head = json.dumps(
            {
                "normal": self.normal,
                "success": self.success,
                "reason": self.reason,
                "error": self.error,
                "files": [[name, len(self.files[name])] for name in names],
            }
        )
        return b"\n".join((head.encode(), b"".join(self.files[name] for name in names)))

    @classmethod
    def decode(cls, data: bytes) -> TaskResult:
        """Return the result in these bytes; `ValueError` if they are not one."""
        head, newline, body = data.partition(b"\n")
        try:
            fields = json.loads(head)
            files, begin = {}, 0
            for name, size in fields["files"]:
                files[str(name)] = body[begin : begin + int(size)]
                begin += int(size)
            texts = (str(fields["reason"]), str(fields["error"]))
            result = cls(bool(fields["normal"]), bool(fields["success"]), texts[0], files, texts[1])
        except (KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"it is not the result of a run: {error!r}") from error
        if not newline or begin != len(body):
            raise ValueError(f"it has {len(body):,} bytes of files instead of {begin:,}")
        return result


def digest(data: bytes) -> str:
    """Return the digest of an encoded result."""
    return blake2b(data, digest_size=20).hexdigest()


def pack(data: bytes) -> bytes:
    """Compress an encoded result."""
    compressed: bytes = lz4.frame.compress(data)
    return len(data).to_bytes(8, "big") + compressed


def unpack_result(packed: bytes) -> bytes:
    """Return an encoded result that was compressed; `ValueError` if it is damaged or too large."""
    size = int.from_bytes(packed[:8], "big")
    if size > MOST_RESULT_BYTES:
        raise ValueError(
            f"it has {megabytes(size)} MB, more than the {megabytes(MOST_RESULT_BYTES)} MB that "
            "are allowed"
        )
    return unpack(packed[8:], "lz4", size)

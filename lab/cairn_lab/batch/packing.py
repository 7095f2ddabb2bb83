"""Packs a deployment with all files that it names, so that it can run on another computer.

Each path of a deployment that leads to a file gets a folder of its own, with the files that this
one names beside it: pictures of a world, the image of a map. So neither the folder of a project nor
that of a report changes what is packed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cairn.deployment.model import Deployment, Member
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.limits.files import megabytes, read_bounded
from cairn.runtime.input_files import (
    MOST_FILES,
    content_digest,
    is_name,
    named_files,
    path_parameters,
    sqlite_files,
)
from cairn.runtime.parameters import ReadPathMark, marked_parameters
from cairn.system.files import explain_os_error
from cairn_lab.batch.code_versions import code_versions
from cairn_lab.batch.task import MOST_INPUT_BYTES, ROOT, RUN, PackedDeployment

_FILES = "files"
_NOT_OF_A_RUN = {"settings": {}, "bus": {}, "domain": 0}
"""What a run in lockstep does not use: settings are replaced already, and its bus is in memory."""


def pack_deployment(deployment: Deployment, report: Path) -> PackedDeployment:
    """Return the deployment with the contents of its files; `report` is its `settings.report`.

    Raises `CairnError` if a file cannot be read, or if all are larger than `MOST_INPUT_BYTES`.
    """
    packing = _Packing(report.absolute())
    document = json.loads(deployment.model_dump_json(exclude=set(_NOT_OF_A_RUN))) | _NOT_OF_A_RUN
    if document["robot_description"] is not None:
        packed = packing.path(Path(document["robot_description"]).absolute(), is_read=True)
        document["robot_description"] = packed
    specs = dict(component_specs(document["components"]))
    for member in deployment.members():
        if member.name in specs:  # not those that other keys of the deployment add
            parameters = packing.parameters(member)
            specs[member.name]["parameters"] = parameters
    modules = {load_plugin(one.spec.plugin).__module__ for one in deployment.members()}
    return PackedDeployment(
        document=json.dumps(document),
        files=packing.files,
        folders=tuple(packing.folders),
        contents=packing.contents,
        code=code_versions(module.partition(".")[0] for module in modules),
        origins=packing.origins | {RUN: "${report}"},
    )


def component_specs(components: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the mapping of each component of a deployment's document, at any depth."""
    for name, spec in components.items():
        yield name, spec
        yield from component_specs(spec["children"])


class _Packing:
    """The files of a deployment; each path that it names has a folder with a number."""

    def __init__(self, report: Path) -> None:
        self.files: dict[str, str] = {}
        self.folders: list[str] = []
        self.contents: dict[str, bytes] = {}
        self.origins: dict[str, str] = {}
        self._report = report
        self._packed: dict[Path, str] = {}
        self._bytes = 0

    def parameters(self, member: Member) -> dict[str, Any]:
        """Return the parameters of a component with packed paths."""
        config = (
            load_plugin(member.spec.plugin)
            .config_class()
            .model_validate(dict(member.spec.parameters))
        )
        parameters = json.loads(json.dumps(member.spec.parameters))
        is_read = {one.name for one in marked_parameters(config, ReadPathMark)}
        paths = path_parameters(config)
        for name, path in paths.items():
            words = [text for text in _texts(parameters) if _is_beside(path, text)]
            packed = self.path(path, is_read=name in is_read, words=words)
            _set(parameters, name.split("."), packed)
        return {name: self._with_packed_texts(value) for name, value in parameters.items()}

    def path(self, path: Path, *, is_read: bool, words: Sequence[str] = ()) -> str:
        """Return the packed path of a file or folder, which need not exist.

        The content of a folder is packed if the component only reads it. `words` name files
        relative to the folder of the path.
        """
        if path.is_relative_to(self._report):
            return RUN if path == self._report else f"{RUN}/{path.relative_to(self._report)}"
        try:
            if path not in self._packed:
                self._pack(path, words, is_read=is_read)
            for word in words:
                self._add_beside(path, word)
        except OSError as error:
            raise CairnError(f"{path}: it cannot be read: {explain_os_error(error)}") from error
        return self._packed[path]

    def _pack(self, path: Path, words: Sequence[str] = (), *, is_read: bool) -> None:
        if path.is_file():
            self._pack_file(path, words)
            return
        place = self._new_place(path, words)  # a run may create what does not exist
        if path.is_dir():
            self.folders.append(f"{place}/{path.name}")
            for file in self._files_in(path) if is_read else ():
                self._add(f"{place}/{path.name}/{file.relative_to(path)}", file)

    def _pack_file(self, path: Path, words: Sequence[str]) -> None:
        named = list(named_files(path))
        relative = [word for word, _ in named if not os.path.isabs(word)]
        place = self._new_place(path, [*relative, *words])
        content = read_bounded(path, MOST_INPUT_BYTES)
        for word, file in named:
            if os.path.isabs(word):
                if file not in self._packed:
                    self._pack(file, is_read=True)
                other = os.path.relpath(self._packed[file], f"{ROOT}/{place}")
                content = content.replace(word.encode(), other.encode())
        self._add(f"{place}/{path.name}", path, content)
        for file in sqlite_files(path):
            self._add(f"{place}/{file.name}", file)
        for word in relative:
            self._add_beside(path, word)

    def _add_beside(self, path: Path, word: str) -> None:
        """Add a file that is named relative to the folder of a path that is packed."""
        place = os.path.dirname(self._packed[path]).removeprefix(f"{ROOT}/")
        name = os.path.normpath(f"{place}/{word}")
        if not name.startswith("/".join(place.split("/")[:2]) + "/"):
            raise CairnError(
                f"{path.parent / word}: this file lies above the folder of {path}, which another "
                "component names, too; give its absolute path"
            )
        self._add(name, path.parent / word)

    def _with_packed_texts(self, value: Any) -> Any:
        """Return a value in which the absolute paths of files are packed ones."""
        if isinstance(value, dict):
            return {key: self._with_packed_texts(one) for key, one in value.items()}
        if isinstance(value, list):
            return [self._with_packed_texts(one) for one in value]
        if isinstance(value, str) and os.path.isabs(value) and not value.startswith(f"{ROOT}/"):
            path = Path(value)
            if path.is_relative_to(self._report) or (is_name(value) and path.is_file()):
                return self.path(path, is_read=True)
        return value

    def _new_place(self, path: Path, words: Sequence[str]) -> str:
        """Return a new folder for a path, as deep as the names `words` climb (`../a.png`)."""
        climbs = [os.path.normpath(word).split("/").count("..") for word in words]
        number = len(self._packed)
        place = "/".join([f"{_FILES}/{number}", *["up"] * max(climbs, default=0)])
        self._packed[path] = f"{ROOT}/{place}/{path.name}"
        self.origins[f"{ROOT}/{place}/"] = f"{path.parent}/"
        self.folders.append(place)
        return place

    def _files_in(self, folder: Path) -> Iterator[Path]:
        found = [file for file in sorted(folder.rglob("*")) if file.is_file()]
        if len(found) > MOST_FILES:
            raise CairnError(
                f"{folder}: it has {len(found):,} files, more than the {MOST_FILES:,} that a run "
                "may need; give a folder with fewer"
            )
        yield from found

    def _add(self, name: str, file: Path, content: bytes | None = None) -> None:
        if name in self.files:
            return
        content = read_bounded(file, MOST_INPUT_BYTES) if content is None else content
        digest = content_digest(content)
        self.files[name] = digest
        if digest in self.contents:
            return
        self.contents[digest] = content
        self._bytes += len(content)
        if self._bytes > MOST_INPUT_BYTES:
            raise CairnError(
                f"{file}: with it, the deployment's files are larger than the "
                f"{megabytes(MOST_INPUT_BYTES)} MB that a run may need; give smaller files"
            )


def _is_beside(path: Path, text: str) -> bool:
    """Return whether a text names a file relative to the folder of a path."""
    return is_name(text) and not os.path.isabs(text) and (path.parent / text).is_file()


def _texts(value: Any) -> Iterator[str]:
    """Yield the texts within a value of JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _texts(one)
    elif isinstance(value, list):
        for one in value:
            yield from _texts(one)


def _set(parameters: dict[str, Any], names: list[str], value: str) -> None:
    for name in names[:-1]:
        parameters = parameters.setdefault(name, {})
    parameters[names[-1]] = value

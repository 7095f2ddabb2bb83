"""The files that a re-run component reads: as they were when it was started, in a folder apart."""

from base64 import b64decode
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.runtime.call_records import StartInfo
from cairn.runtime.input_files import (
    InputFile,
    content_digest,
    file_digest,
    input_files,
    path_parameters,
)
from cairn.runtime.parameters import ReadPathMark, marked_parameters

ATTACHED: Final = "files/"
"""Attachments with this prefix are input files: `files/DIGEST/NAME`."""

MOST_ATTACHED: Final = 500
"""Files attached to a recording, and their size together [bytes]."""
MOST_ATTACHED_BYTES: Final = 64 << 20


def input_attachments(deployment: Deployment) -> dict[str, bytes]:
    """Return the input files of all components that a recording should keep, by attachment name.

    Small files come first; beyond 500 files or 64 MiB the rest is left out. A component that reads
    one of these can be re-run while the file exists unchanged.
    """
    found: dict[str, tuple[int, Path]] = {}
    for member in deployment.members():
        try:
            plugin = load_plugin(member.spec.plugin)
            config = plugin.config_class().model_validate(dict(member.spec.parameters))
        except (CairnError, ValueError):
            continue  # it cannot start either
        if plugin.clock_source == "device":
            continue
        for file in input_files(config):
            if file.digest:
                name = f"{ATTACHED}{file.digest}/{Path(file.path).name}"
                found[name] = (file.size, Path(file.path))
    attached: dict[str, bytes] = {}
    left = MOST_ATTACHED_BYTES
    for name, (size, path) in sorted(found.items(), key=lambda one: one[1][0]):
        if size > left or len(attached) >= MOST_ATTACHED:
            break
        try:
            attached[name] = path.read_bytes()
        except OSError:
            continue
        left -= len(attached[name])
    return attached


def with_files(
    info: StartInfo, folder: Path, attached: Callable[[str], bytes | None]
) -> tuple[StartInfo, list[str]]:
    """Provide a start's files; return the start with the paths of those.

    Files that the component only reads stay where they are if they are unchanged. All others are
    copied below `folder`: from the log, from what `attached` returns for their digest (None if it
    has none), or from where they were. The second value names what is missing.

    Which parameters are paths follows from the plugin, not from the recording: so a component does
    not write to a path that a foreign recording names.
    """
    missing = []
    paths, read_paths = _path_parameters(info)
    unchanged = {file.path for file in info.files if _is_unchanged(file)}
    in_place = {
        path
        for name, path in paths.items()
        if name in read_paths
        and all(file.path in unchanged for file in info.files if _is_near(file.path, path))
        and Path(path).exists()
    }
    moved = set(paths.values()) - in_place
    for file in info.files:
        if any(_is_near(file.path, path) for path in in_place) and not any(
            _is_near(file.path, path) for path in moved
        ):
            continue
        content = _embedded(file) or (attached(file.digest) if file.digest else None)
        if content is None or content_digest(content) != file.digest:
            content = Path(file.path).read_bytes() if file.path in unchanged else None
        if content is None:
            missing.append(
                f"{file.path} ({file.size:,} bytes) is not attached to the recording, and does not "
                "exist unchanged"
            )
            continue
        copy = _below(folder, file.path)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(content)
    parameters: dict[str, Any] = dict(info.parameters)
    for name, path in paths.items():
        if path in in_place and name in read_paths:
            continue
        copy = _below(folder, path)
        copy.parent.mkdir(parents=True, exist_ok=True)
        parameters = _with_value(parameters, name.split("."), str(copy))
    return info.model_copy(update={"parameters": parameters}), missing


def _path_parameters(info: StartInfo) -> tuple[dict[str, str], set[str]]:
    """Return the paths in the parameters of a start, and the names of those that are only read.

    Raises `CairnError` if the plugin is missing, or rejects the parameters.
    """
    try:
        config = load_plugin(info.plugin).config_class().model_validate(info.parameters)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise CairnError(
            f"{info.name}: cannot be re-run: {info.plugin} rejects the recorded parameter {where}: "
            f"{first['msg']}"
        ) from error
    paths = {
        name: info.paths.get(name, str(path)) for name, path in path_parameters(config).items()
    }
    return paths, {one.name for one in marked_parameters(config, ReadPathMark)}


def _embedded(file: InputFile) -> bytes | None:
    try:
        return b64decode(file.content, validate=True) if file.content else None
    except ValueError:  # damaged: its digest would not fit either
        return None


def _is_near(file: str, path: str) -> bool:
    """Return whether a file is at a path, below it, or beside it, where it may be named."""
    return Path(path).parent in Path(file).parents


def _is_unchanged(file: InputFile) -> bool:
    path = Path(file.path)
    try:
        return bool(
            file.digest and path.stat().st_size == file.size and file_digest(path) == file.digest
        )
    except (OSError, ValueError):  # ValueError: the path has a zero byte
        return False


def _below(folder: Path, path: str) -> Path:
    """Return where the copy of a file lies; a path with `..` stays below the folder, too."""
    # pathlib keeps two slashes at the begin: with `//` as a part, the path would be absolute.
    parts = [part for part in Path(path).parts if part != ".." and not part.startswith("/")]
    return folder.joinpath(*parts)


def _with_value(values: dict[str, Any], names: list[str], value: Any) -> dict[str, Any]:
    name, *rest = names
    if rest:
        value = _with_value(dict(values.get(name) or {}), rest, value)
    return {**values, name: value}

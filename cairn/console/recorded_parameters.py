"""The parameters that are attached to a recording, as a console shows those of a running robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from cairn.errors import CairnError
from cairn.limits.json import parse_json
from cairn.recording.reader import McapRecording

PARAMETERS: Final = "parameters.json"
_LONGEST: Final = 16 << 20


def attached_parameters(recording: McapRecording) -> dict[str, dict[str, Any]]:
    """Return the parameters of each component by dotted name; none if they are not attached.

    Raises `CairnError` if the attachment is damaged.
    """
    content = recording.find_attachment(PARAMETERS)
    if content is None:
        return {}
    try:
        attached = parse_json(content, _LONGEST)
        if not isinstance(attached, dict):
            raise ValueError("it is not an object with the parameters of each component")
    except ValueError as error:
        file = recording.files[0]
        raise CairnError(f"{file}: {PARAMETERS} is not shown: {error}") from error
    return {name: dict(_flat(values)) for name, values in attached.items()}


def parameter_entries(parameters: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return parameters as the method `parameters` does, without bounds and descriptions."""
    return [
        {
            "name": name,
            "value": value,
            "type": type(value).__name__,
            "bounds": "",
            "description": "",
        }
        for name, value in parameters.items()
    ]


def _flat(values: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values; those of a group have the group's name before them."""
    if not isinstance(values, dict):
        return
    for name, value in values.items():
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value

"""Messages as plain values, for people and for JSON."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def to_plain(message: Any, longest: int | None = None) -> Any:
    """A message as dictionaries, lists and scalars.

    Sequences longer than `longest` are cut, with a note of how many elements were left out.
    """
    if is_dataclass(message):
        return {
            field.name: to_plain(getattr(message, field.name), longest) for field in fields(message)
        }
    if isinstance(message, np.ndarray):
        shown = message if longest is None else message[:longest]
        return _cut(shown.tolist(), len(message))
    if isinstance(message, str | bytes | int | float | bool):
        return message
    if isinstance(message, np.generic):
        return message.item()
    items = list(message)
    shown_items = items if longest is None else items[:longest]
    return _cut([to_plain(item, longest) for item in shown_items], len(items))


def _cut(shown: list[Any], length: int) -> list[Any]:
    left = length - len(shown)
    return [*shown, f"... {left} more"] if left else shown

"""What a model of a world does not take, in plain words."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from cairn import Config
from cairn.deployment.problems import suggestion

_PLAIN = {
    "missing": "must be given",
    "finite_number": "must be a finite number",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "string_pattern_mismatch": "may have letters, digits, _, . and - only",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
}


def what_is_wrong(error: ValidationError, model: type[Config]) -> str:
    """What `model` does not take, in one line: where, the value, and what it must be."""
    return "; ".join(_told(one, model) for one in error.errors())


def _told(error: ErrorDetails, model: type[Config]) -> str:
    path = ""
    for part in error["loc"]:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    kind = error["type"]
    shown = "" if kind in ("missing", "value_error") else f" = {str(error['input'])[:60]!r}"
    why = _why(error, model)
    return f"{path}{shown}: {why}" if path else why


def _why(error: ErrorDetails, model: type[Config]) -> str:
    kind, limits = error["type"], error.get("ctx", {})
    if kind in _PLAIN:
        return _PLAIN[kind]
    if kind == "extra_forbidden":
        *place, key = error["loc"]
        return f"there is no such key; {suggestion(str(key), _keys_at(model, place))}"
    if kind in ("model_type", "dict_type"):
        return f"must be a mapping with the keys {', '.join(_keys_at(model, error['loc']))}"
    if kind == "too_short":
        return f"must have at least {limits['min_length']} items, not {limits['actual_length']}"
    if kind == "too_long":
        return f"must have at most {limits['max_length']} items, not {limits['actual_length']}"
    why = error["msg"].removeprefix("Value error, ")
    return re.sub(r"^\w+ should ", "must ", why[0].lower() + why[1:])


def _keys_at(model: type[Config], place: Any) -> list[str]:
    """The keys of the mapping at a place within a model."""
    for part in place:
        if isinstance(part, str):
            model = next(_models_in(model.model_fields[part].annotation))
    return list(model.model_fields)


def _models_in(annotation: Any) -> Iterator[type[Config]]:
    if get_origin(annotation) is None:
        if isinstance(annotation, type) and issubclass(annotation, Config):
            yield annotation
        return
    for part in get_args(annotation):
        yield from _models_in(part)

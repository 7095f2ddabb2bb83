"""Validation: check a part of a document against a pydantic model, one problem per error.

The model is a section of the format (`cairn.deployment.model`) or the `Config` of a plugin, whose
fields are a component's parameters.
"""

from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from cairn.deployment.problems import Location, Problem, suggestion
from cairn.deployment.yaml_document import DocumentNode, KeyPath, dotted
from cairn.errors import CairnError
from cairn.runtime.parameters import bounds_text, error_reason

_MAX_SHOWN = 60  # characters of an invalid value


def validation_problems(
    model: type[BaseModel], node: DocumentNode, path: KeyPath, unresolved: frozenset[KeyPath]
) -> list[Problem]:
    """Return what the model rejects in a node at `path`; unresolved references are left out.

    The remedy for an unknown key are the keys that are similar or allowed there.
    """
    try:
        model.model_validate(node.plain())
    except ValidationError as error:
        found = [(_steps(node, detail), detail) for detail in error.errors(include_url=False)]
        return [
            _problem(model, node, path, steps, detail)
            for steps, detail in found
            if (*path, *steps) not in unresolved
        ]
    except CairnError as error:  # of a default, such as that of the domain
        found_text, _, remedy = str(error).partition("; ")
        return [Problem(node.where, dotted(path), found_text, remedy or "correct it")]
    except Exception as error:  # a validator of a plugin may fail in any way
        found_text = f"the check of its values failed: {type(error).__name__}: {error}"
        remedy = f"correct {model.__module__}.{model.__qualname__}, or the values"
        return [Problem(node.where, dotted(path), found_text, remedy)]
    return []


def _steps(node: DocumentNode, detail: ErrorDetails) -> KeyPath:
    """Return the error's path as far as it exists in the document, and a last, missing step."""
    steps: KeyPath = ()
    for step in detail["loc"]:
        if node.find(*steps, step) is None:
            return (*steps, str(step)) if detail["type"] == "missing" else steps
        steps = (*steps, str(step))
    return steps


def _problem(
    model: type[BaseModel], node: DocumentNode, path: KeyPath, steps: KeyPath, detail: ErrorDetails
) -> Problem:
    value = node.find(*steps)
    shown = dotted((*path, *steps))
    field = _field(model, steps)
    if detail["type"] == "missing" or value is None:
        return Problem(_enclosing(node, steps), shown, "is missing", f"give {_meaning(field)}")
    key_at = value.key_at or value.at
    if detail["type"] == "extra_forbidden":
        return Problem(
            key_at,
            shown,
            f"there is no {steps[-1]} here",
            suggestion(steps[-1], _fields(model, steps[:-1])),
        )
    if detail["loc"][-1:] == ("[key]",):
        remedy = "names are lower-case letters, digits and _, and begin with a letter"
        return Problem(key_at, shown, f"{steps[-1]!r} is not a valid name", remedy)
    found = error_reason(detail)
    if detail["type"] not in ("value_error", "assertion_error"):
        found = f"{_written(value)} {found}"
    return Problem(value.where, shown, found, f"expected {_meaning(field)}")


def _enclosing(node: DocumentNode, steps: KeyPath) -> Location:
    parent = node.find(*steps[:-1])
    return parent.where if parent is not None else node.where


def _meaning(field: FieldInfo | None) -> str:
    if field is None:
        return "values that agree with each other"
    limits = f" ({bounds_text(field)})" if bounds_text(field) else ""
    return f"{(field.description or 'a value').rstrip('.')}{limits}"


def _written(node: DocumentNode) -> str:
    if isinstance(node.value, Mapping):
        return "a mapping"
    if isinstance(node.value, tuple):
        return "a list"
    if node.value is None or isinstance(node.value, bool):
        return {None: "null", True: "true", False: "false"}[node.value]
    text = repr(node.value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


def _field(model: type[BaseModel], steps: KeyPath) -> FieldInfo | None:
    """Return the field at a path in the model, or that of the list or mapping around it."""
    for end in range(len(steps), 0, -1):
        field = _fields(model, steps[: end - 1]).get(steps[end - 1])
        if field is not None:
            return field
    return None


def _fields(model: type[BaseModel], steps: KeyPath) -> dict[str, FieldInfo]:
    """Return the fields that the model has at a path in it."""
    annotations: list[Any] = [model]
    for step in steps:
        inner = []
        for annotation in annotations:
            if _is_model(annotation):
                field = annotation.model_fields.get(step)
                inner += list(_parts(field.annotation)) if field is not None else []
            else:  # the values of a dict, the items of a list or tuple
                inner += [part for one in get_args(annotation)[-1:] for part in _parts(one)]
        annotations = inner
    models = [annotation for annotation in annotations if _is_model(annotation)]
    return {name: field for one in models for name, field in one.model_fields.items()}


def _parts(annotation: Any) -> Iterator[Any]:
    """Yield an annotation and, for a union, its members."""
    yield annotation
    yield from (part for part in get_args(annotation) if _is_model(part))


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)

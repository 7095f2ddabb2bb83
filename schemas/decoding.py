"""Makes messages of fields read from the wire, which are of the right types already."""

from collections.abc import Callable
from dataclasses import fields
from math import isfinite
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from cairn.schemas.arrays import array_validator
from cairn.schemas.message import own_check
from cairn.schemas.primitives import Array, Scalar, Text, mark_of

T = TypeVar("T")


def maker(message: type[T]) -> Callable[..., T]:
    """A function of a message's fields in order, as a decoder of CDR has read them.

    Numbers and strings are Python's, numeric sequences are read-only arrays, other sequences
    lists. It makes and refuses the same messages as the class's constructor, and halves the time
    of decoding: it checks only what the definition demands beyond the types on the wire, and
    leaves whatever is not plainly valid to the constructor. As that of a dataclass it is
    generated, because a loop over the fields would be as slow as the constructor.
    """
    hints = get_type_hints(message, include_extras=True)
    names = [field.name for field in fields(message)]  # type: ignore[arg-type]
    # No field of a ROS 2 message begins with an underscore.
    known: dict[str, Any] = {"_message": message, "_new": object.__new__, "_isfinite": isfinite}
    conditions = [text for name in names if (text := _condition(name, hints[name], known))]
    parts = [
        f"{name}=tuple({name})" if get_origin(hints[name]) is tuple else f"{name}={name}"
        for name in names
    ]
    arguments = ", ".join(names)
    lines = [f"def make({arguments}):"]
    if conditions:
        lines += [f"    if not ({' and '.join(conditions)}):"]
        lines += [f"        return _message({arguments})"]
    lines += ["    made = _new(_message)", f"    made.__dict__.update({', '.join(parts)})"]
    check = own_check(message)
    if check is not None:
        known["_check"] = check
        lines += ["    _check(made)"]
    lines += ["    return made"]
    exec(compile("\n".join(lines), f"<maker of {message.__qualname__}>", "exec"), known)
    return cast("Callable[..., T]", known["make"])


def _condition(name: str, hint: Any, known: dict[str, Any]) -> str:
    """What must hold of a field of the right type to be plainly valid, as Python text."""
    match mark_of(hint):
        case Scalar() as mark:
            return _number_condition(name, mark)
        case Text() as mark:
            return _text_condition(name, mark)
        case Array() as mark:
            return _array_condition(name, mark, known)
    if get_origin(hint) is tuple:
        element = mark_of(get_args(hint)[0])
        if isinstance(element, Text):
            return f"all([{_text_condition('text', element)} for text in {name}])"
    return ""  # another message, or several, each made already


def _number_condition(name: str, mark: Scalar) -> str:
    limits = [
        f"{name} {sign} {limit!r}"
        for sign, limit in ((">", mark.above), (">=", mark.at_least), ("<=", mark.at_most))
        if limit is not None
    ]
    if limits or mark.finite:
        limits.append(f"_isfinite({name})")
    return " and ".join(limits)


def _text_condition(name: str, mark: Text) -> str:
    return f"{name} in {mark.one_of!r}" if mark.one_of else f"'\\0' not in {name}"


def _array_condition(name: str, mark: Array, known: dict[str, Any]) -> str:
    if mark.ros_type == "bool":
        return "False"
    dtype = np.dtype("uint8" if mark.ros_type in ("byte", "char") else mark.ros_type)
    if mark.check is None:
        known[f"_dtype_{name}"] = dtype
        return f"{name}.dtype is _dtype_{name}"
    validate = array_validator(dtype, mark.length, mark.check)

    def valid(array: Any) -> bool:
        try:
            return validate(array) is array
        except ValueError:
            return False

    known[f"_valid_{name}"] = valid
    return f"_valid_{name}({name})"

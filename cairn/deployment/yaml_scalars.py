"""Scalars by the core schema of YAML 1.2, so that `on`, `no` and `12:30` stay text.

PyYAML implements YAML 1.1, where those are booleans and a base-60 number, and `1e-3` is text.
Source: https://yaml.org/spec/1.2.2/#103-core-schema.
"""

import re

import yaml

_TAG = "tag:yaml.org,2002:"
_RULES = [
    ("null", r"null|Null|NULL|~|", [*"nN~", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", [*"-+0123456789"]),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
]


class CoreLoader(yaml.SafeLoader):
    """PyYAML's parser with the implicit types of YAML 1.2's core schema."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}


for _name, _pattern, _first in _RULES:
    CoreLoader.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), _first)


PLAIN_TAGS = frozenset(_TAG + name for name in ("map", "seq"))


class UnknownTagError(ValueError):
    """A scalar with a tag, or a value for its tag, that the core schema does not know."""


def scalar(node: yaml.ScalarNode) -> str | int | float | bool | None:
    """The Python value of a scalar; `UnknownTagError` for tags such as `!!binary`."""
    text = str(node.value)
    kind = str(node.tag).removeprefix(_TAG)
    try:
        match kind:
            case "str":
                return text
            case "null":
                return None
            case "bool":
                return {"true": True, "false": False}[text.lower()]
            case "int":
                return int(text, 0 if text[:2] in ("0o", "0x") else 10)
            case "float":
                return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    except (KeyError, ValueError) as error:
        raise UnknownTagError(f"{text!r} is not a value of type {kind}") from error
    raise UnknownTagError(f"the tag {node.tag} is not allowed")

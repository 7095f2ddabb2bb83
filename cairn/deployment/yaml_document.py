"""Document: read YAML into a tree in which every key and value knows where it is written.

PyYAML parses; this module keeps the positions, collects all problems in one pass, and reads scalars
by the core schema of YAML 1.2. ruamel.yaml, which keeps positions, would not make it simpler: it
stops at the first duplicate key, reads `1_000` as a number, and its positions do not follow values
through overlays and `${settings}`.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from cairn.deployment.problems import Location, Problem
from cairn.limits.files import RefusedFileError, read_text_bounded
from cairn.limits.yaml import (
    YAML_BYTES,
    YAML_DEPTH,
    YAML_VALUES,
    BoundedComposer,
    YamlLimitError,
)

KeyPath: TypeAlias = tuple[str, ...]


@dataclass(frozen=True)
class DocumentNode:
    """A value at location `at`; `key_at` locates its key, None at the root and in a list."""

    value: "Mapping[str, DocumentNode] | tuple[DocumentNode, ...] | str | int | float | bool | None"
    at: Location
    key_at: Location | None = None

    @property
    def entries(self) -> "Mapping[str, DocumentNode]":
        """The keys and values of a mapping; empty for any other node."""
        return self.value if isinstance(self.value, Mapping) else {}

    @property
    def where(self) -> Location:
        """The location to report for this value: that of its key if it spans several lines."""
        spans = isinstance(self.value, Mapping | tuple)
        return self.key_at if spans and self.key_at is not None else self.at

    def plain(self) -> Any:
        """Return the value as dicts, lists and scalars."""
        if isinstance(self.value, Mapping):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    def key_paths(self) -> "Iterator[KeyPath]":
        """Yield the path of each key below this node, through mappings only."""
        for key, node in self.entries.items():
            yield (key,)
            for below in node.key_paths():
                yield (key, *below)

    def find(self, *steps: str | int) -> "DocumentNode | None":
        """Return the node at a path of keys and list indices, or None."""
        node = self
        for step in steps:
            if isinstance(node.value, Mapping) and str(step) in node.value:
                node = node.value[str(step)]
            elif isinstance(node.value, tuple) and str(step) in map(str, range(len(node.value))):
                node = node.value[int(step)]
            else:
                return None
        return node


def read_document(file: Path) -> tuple[DocumentNode | None, list[Problem]]:
    """Return the tree of a YAML file, which is a mapping, and its problems; None if unreadable."""
    start = Location(str(file), 1, 1, file.absolute().parent)
    try:
        text = read_text_bounded(file, YAML_BYTES)
    except OSError as error:
        start = Location(str(file), 0, 0, start.folder)
        remedy = error.remedy if isinstance(error, RefusedFileError) else "give a readable file"
        return None, [_unreadable(start, error.strerror or str(error), remedy)]
    except UnicodeDecodeError as error:
        return None, [_unreadable(start, str(error), "save the file as UTF-8")]
    node, problems = parse_document(text, start)
    if node is not None and not isinstance(node.value, Mapping):
        found = f"found {_kind(node)}" if text.strip() else "the file is empty"
        return None, [*problems, Problem(start, "", found, "expected a mapping of keys to values")]
    return node, problems


def parse_document(text: str, start: Location) -> tuple[DocumentNode | None, list[Problem]]:
    """Return the tree of a YAML text that starts at a location, and its problems.

    The tree is None if the syntax is wrong.
    """
    try:
        root = yaml.compose(text, Loader=_CoreLoader)
    except YamlLimitError as error:
        at = _location(error.problem_mark, start)
        fault = str(error.problem).removeprefix("it ")
        return None, [Problem(at, "", f"the file {fault}", "write fewer")]
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = ", ".join(part for part in (error.context, error.problem) if part)
        return None, [_syntax(_location(mark, start), what)]
    except yaml.YAMLError as error:
        return None, [_syntax(start, " ".join(str(error).split()))]
    if root is None:
        return DocumentNode(None, start), []
    builder = _Builder(start)
    try:
        return builder.node(root, None, ()), builder.problems
    except _TooMuchError as error:
        return None, [Problem(start, "", f"the file {error}", "write fewer")]


def component_nodes(root: DocumentNode) -> Iterator[tuple[str, KeyPath, DocumentNode]]:
    """Yield name, path and node of each component at any depth, in start order."""
    yield from _below(root, "components", ())


def dotted(steps: tuple[str | int, ...]) -> str:
    """Return a path as shown and as given to `--set`: components by name, without parents."""
    names = [str(step) for step in steps]
    shown = names[:2]
    rest = names[2:]
    while shown[:1] == ["components"] and len(rest) >= 2 and rest[0] == "children":
        shown, rest = ["components", rest[1]], rest[2:]
    return ".".join([*shown, *rest])


class _TooMuchError(Exception):
    """A file exceeds a limit and is not read further."""


class _Builder:
    """Converts PyYAML's nodes to `DocumentNode`, collecting what the format does not allow."""

    def __init__(self, start: Location) -> None:
        self.start = start
        self.problems: list[Problem] = []
        self.open: set[int] = set()
        self.built = 0

    def node(self, raw: yaml.Node, key_at: Location | None, path: KeyPath) -> DocumentNode:
        at = _location(raw.start_mark, self.start)
        self.built += 1
        if self.built > YAML_VALUES:
            raise _TooMuchError(
                f"holds more than {YAML_VALUES:,} values, with its aliases expanded"
            )
        if len(path) > YAML_DEPTH:
            raise _TooMuchError(f"is nested deeper than {YAML_DEPTH} levels at {at}")
        if id(raw) in self.open:
            self.report(at, path, "the alias contains itself", "write the values out")
            return DocumentNode(None, at, key_at)
        self.open.add(id(raw))
        try:
            return DocumentNode(self.value(raw, at, path), at, key_at)
        finally:
            self.open.remove(id(raw))

    def value(
        self, raw: yaml.Node, at: Location, path: KeyPath
    ) -> Mapping[str, DocumentNode] | tuple[DocumentNode, ...] | str | int | float | bool | None:
        if isinstance(raw, yaml.CollectionNode) and raw.tag not in _PLAIN_TAGS:
            self.report(at, path, f"the tag {raw.tag} is not allowed", "write the plain value")
        if isinstance(raw, yaml.MappingNode):
            return self.mapping(raw, path)
        if isinstance(raw, yaml.SequenceNode):
            return tuple(
                self.node(item, None, (*path, str(index))) for index, item in enumerate(raw.value)
            )
        assert isinstance(raw, yaml.ScalarNode)
        try:
            return _scalar(raw)
        except _UnknownTagError as error:
            self.report(at, path, str(error), "write the plain value")
            return None

    def mapping(self, raw: yaml.MappingNode, path: KeyPath) -> dict[str, DocumentNode]:
        entries: dict[str, DocumentNode] = {}
        for raw_key, raw_value in raw.value:
            at = _location(raw_key.start_mark, self.start)
            if not isinstance(raw_key, yaml.ScalarNode):
                self.report(at, path, "a list or mapping used as a key", "use text as the key")
                continue
            key = str(raw_key.value)
            if key in entries:
                first = entries[key].key_at
                self.report(
                    at, (*path, key), f"the key occurs twice, first at {first}", "remove one"
                )
                continue
            entries[key] = self.node(raw_value, at, (*path, key))
        return entries

    def report(self, at: Location, path: KeyPath, found: str, remedy: str) -> None:
        self.problems.append(Problem(at, dotted(path), found, remedy))


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


class _CoreLoader(BoundedComposer):
    """PyYAML's parser with the implicit types of YAML 1.2's core schema.

    So `on`, `no` and `12:30` stay text. PyYAML implements YAML 1.1, where those are booleans and a
    base-60 number, and `1e-3` is text. Source: https://yaml.org/spec/1.2.2/#103-core-schema.
    """

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}
    allow_cycles = True  # reported with the other problems


for _name, _pattern, _first in _RULES:
    _CoreLoader.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), _first)


_PLAIN_TAGS = frozenset(_TAG + name for name in ("map", "seq"))


class _UnknownTagError(ValueError):
    """A scalar with a tag, or a value for its tag, that the core schema does not define."""


def _scalar(node: yaml.ScalarNode) -> str | int | float | bool | None:
    """Return the Python value of a scalar; `_UnknownTagError` for tags such as `!!binary`."""
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
        raise _UnknownTagError(f"{text[:60]!r} is not a value of type {kind}") from error
    raise _UnknownTagError(f"the tag {node.tag} is not allowed")


def _below(
    parent: DocumentNode, key: str, path: KeyPath
) -> Iterator[tuple[str, KeyPath, DocumentNode]]:
    mapping = parent.find(key)
    if mapping is None:
        return
    for name, node in mapping.entries.items():
        place = (*path, key, name)
        yield name, place, node
        yield from _below(node, "children", place)


def _location(mark: yaml.Mark | None, start: Location) -> Location:
    if mark is None or not start.line:
        return start
    return Location(start.origin, mark.line + 1, mark.column + 1, start.folder)


def _kind(node: DocumentNode) -> str:
    return "a list" if isinstance(node.value, tuple) else f"{node.value!r}"


def _syntax(at: Location, what: str) -> Problem:
    return Problem(at, "", f"invalid YAML: {what}", "correct the syntax")


def _unreadable(at: Location, what: str, remedy: str) -> Problem:
    return Problem(at, "", f"the file cannot be read: {what}", remedy)

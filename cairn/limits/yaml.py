"""Read YAML with limits on its size, depth, number of values and length of numbers.

PyYAML has none: a few hundred bytes of aliases stand for billions of values, deep nesting exhausts
the stack, and a number of 5,000 digits or an impossible date raises an error without position.
"""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any, Final

import yaml

from cairn.limits.files import read_text_bounded

YAML_BYTES: Final = 1_000_000
"""Largest YAML file [bytes]: 50 times the largest deployment or world that Cairn ships."""

YAML_VALUES: Final = 50_000
"""Most keys and values of a YAML file, with its aliases expanded: 40 times the largest world that
Cairn ships. PyYAML needs 30 us for each."""

YAML_DEPTH: Final = 100
"""Most levels of lists and mappings in each other."""

NUMBER_CHARACTERS: Final = 100
"""Longest number; one of 64 bits needs 20 characters."""

_NUMBERS: Final = frozenset(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float"))
_INVALID: Final = (ValueError, KeyError, AttributeError, TypeError, IndexError, OverflowError)


class YamlLimitError(yaml.MarkedYAMLError):
    """A YAML text exceeds a limit."""


class BoundedComposer(yaml.SafeLoader):
    """PyYAML's parser, which checks the limits while it composes; a base of other loaders."""

    allow_cycles = False
    """Whether an alias may stand within the value that it repeats: the caller rejects it."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._count = 0
        self._depth = 0
        self._open: set[int] = set()
        self._sizes: dict[int, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a value; raise `YamlLimitError` at the first one that exceeds a limit."""
        is_alias = bool(self.check_event(yaml.AliasEvent))
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]  # of PyYAML
        if not is_alias:
            self._count += 1
            if self._count > YAML_VALUES:  # before the whole text is parsed, which is slow
                raise _refused(f"it holds more than {YAML_VALUES:,} values", mark)
            self._depth += 1
            if self._depth > YAML_DEPTH:
                raise _refused(f"it is nested deeper than {YAML_DEPTH} levels", mark)
        node = super().compose_node(parent, index)
        if not is_alias:
            self._depth -= 1
        if node is None:
            return None
        if is_alias and id(node) not in self._sizes and not self.allow_cycles:
            raise _refused("the alias contains itself", mark)
        if isinstance(node, yaml.ScalarNode):
            if node.tag in _NUMBERS and len(node.value) > NUMBER_CHARACTERS:
                raise _refused(
                    f"it has a number of {len(node.value):,} digits ({node.value[:12]}...), more "
                    f"than the {NUMBER_CHARACTERS} that are allowed",
                    mark,
                )
            size = 1
        elif is_alias:
            size = self._sizes.get(id(node), 1)
        elif isinstance(node, yaml.MappingNode):
            size = 1 + sum(self._sizes.get(id(part), 1) for pair in node.value for part in pair)
        else:
            size = 1 + sum(self._sizes.get(id(part), 1) for part in node.value)
        if size > YAML_VALUES:
            raise _refused(
                f"it holds more than {YAML_VALUES:,} values, with its aliases expanded", mark
            )
        self._sizes[id(node)] = size
        return node


class _Loader(BoundedComposer):
    """Converts to Python values; rejects duplicate keys, and gives errors a position."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """Return the value of a node; raise `MarkedYAMLError` if its tag does not fit."""
        try:
            return super().construct_object(node, deep)
        except _INVALID as error:
            value = repr(node.value)[:60] if isinstance(node, yaml.ScalarNode) else "it"
            kind = str(node.tag).rpartition(":")[2]
            raise yaml.constructor.ConstructorError(
                None, None, f"{value} is not a value of type {kind}", node.start_mark
            ) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return a mapping; raise an error if two of its keys are equal."""
        keys = set()
        for key, _ in node.value:
            if str(key.value) in keys:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"the key {str(key.value)[:60]} is given twice; remove one",
                    key.start_mark,
                )
            keys.add(str(key.value))
        return super().construct_mapping(node, deep)


class _OpenCvLoader(_Loader):
    """Also reads the matrices of OpenCV's FileStorage, as mappings."""


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


_OpenCvLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", _mapping)
_OPENCV_HEAD: Final = "%YAML:1.0"  # YAML writes %YAML 1.0


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML text; raise `yaml.YAMLError` if it is invalid or too large."""
    return yaml.load(text, _Loader)


def parse_opencv_yaml(text: str) -> Any:
    """Return the value of a YAML text, also of one that OpenCV has written; else as `parse_yaml`.

    A matrix is a mapping with `rows`, `cols` and `data`.
    """
    return yaml.load(text.removeprefix(_OPENCV_HEAD), _OpenCvLoader)


def read_yaml(file: Path) -> Any:
    """Return the content of a YAML file.

    Raises `OSError` if it cannot be read or is too large, `UnicodeDecodeError` if it is not text,
    `yaml.YAMLError` as `parse_yaml`.
    """
    return parse_yaml(read_text_bounded(file, YAML_BYTES))


def yaml_fault(error: yaml.YAMLError) -> tuple[str, str]:
    """Return the position of an error, `:line:column` or "", and what is wrong, in one line."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return "", " ".join(str(error).split())
    mark = error.problem_mark or error.context_mark
    position = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
    return position, str(error.problem or error.context)


def no_boolean(value: object) -> object:
    """Return a value of a field that holds numbers; raise `ValueError` for true and false.

    For `pydantic.BeforeValidator`: pydantic takes them for 1 and 0.
    """
    if isinstance(value, bool):
        raise ValueError("must be a number, not a boolean")
    return value


def _refused(reason: str, mark: yaml.Mark) -> YamlLimitError:
    return YamlLimitError(None, None, reason, mark)

"""Interpolation: replace `${name}` by settings, frames, and `${here}` by the folder of the file.

OmegaConf interpolates too, but stops at the first mistake and does not know the lines of a file.
"""

import re
from collections.abc import Mapping

from cairn.deployment.frames import DESCRIPTION, FRAMES, FrameReferences
from cairn.deployment.problems import Location, Problem, suggestion
from cairn.deployment.yaml_document import DocumentNode, KeyPath, dotted
from cairn.errors import CairnError

# "$${" is a literal "${"; the last alternative matches a reference that is not closed.
_REFERENCE = re.compile(r"\$\$\{|\$\{([^{}]*)\}|\$\{")

_LONGEST_TEXT = 100_000


def interpolate(root: DocumentNode) -> tuple[DocumentNode, list[Problem], frozenset[KeyPath]]:
    """Return the tree with all references replaced, the problems, and the unresolved paths.

    A reference that is a whole value takes the setting's type and location; inside a longer text it
    becomes text.
    """
    references = _References(root)
    first = {
        key: references.resolve(root.entries[key], (key,))
        for key in ("settings", FRAMES, DESCRIPTION)
        if key in root.entries
    }
    references.frames = FrameReferences(first.get(FRAMES), first.get(DESCRIPTION))
    references.problems += [
        one for one in references.frames.problems if (one.path,) not in references.unresolved
    ]
    entries = {
        key: first[key] if key in first else references.resolve(node, (key,))
        for key, node in root.entries.items()
    }
    resolved = DocumentNode(entries, root.at, root.key_at)
    return resolved, references.problems, frozenset(references.unresolved)


class _UnresolvedError(Exception):
    """A reference without a value; the problem is recorded already."""


class _References:
    def __init__(self, root: DocumentNode) -> None:
        self.settings = root.find("settings") or DocumentNode({}, root.at)
        self.frames: FrameReferences | None = None  # until they are known
        self.problems: list[Problem] = []
        self.unresolved: set[KeyPath] = set()
        self.resolved: dict[KeyPath, DocumentNode | None] = {}
        self.in_progress: list[KeyPath] = []

    def resolve(self, node: DocumentNode, path: KeyPath) -> DocumentNode:
        if path[:1] == ("settings",) and len(path) > 1:
            return self.setting(path[1:]) or node
        return self.inside(node, path)

    def inside(self, node: DocumentNode, path: KeyPath) -> DocumentNode:
        if isinstance(node.value, Mapping):
            entries = {key: self.resolve(child, (*path, key)) for key, child in node.value.items()}
            return DocumentNode(entries, node.at, node.key_at)
        if isinstance(node.value, tuple):
            items = tuple(
                self.resolve(child, (*path, str(index))) for index, child in enumerate(node.value)
            )
            return DocumentNode(items, node.at, node.key_at)
        if not isinstance(node.value, str):
            return node
        try:
            return self.text(node, node.value, path)
        except _UnresolvedError:
            self.unresolved.add(path)
            return node

    def setting(self, name: KeyPath) -> DocumentNode | None:
        """Return a setting with its own references replaced; None if that is not possible."""
        if name not in self.resolved:
            node = self.settings.find(*name)
            if node is None:
                return None
            place = ("settings", *name)
            self.in_progress.append(name)
            result = self.inside(node, place)
            self.in_progress.pop()
            broken = any(path[: len(place)] == place for path in self.unresolved)
            self.resolved[name] = None if broken else result
        return self.resolved[name]

    def text(self, node: DocumentNode, text: str, path: KeyPath) -> DocumentNode:
        whole = _REFERENCE.fullmatch(text)
        if whole is not None and whole[1] is not None and whole[1].strip() != "here":
            value = self.value(whole[1].strip(), node.at, path)
            return DocumentNode(value.value, value.at, node.key_at)
        replaced = _REFERENCE.sub(lambda match: self.replacement(match, node.at, path), text)
        if len(replaced) > _LONGEST_TEXT:
            found = f"with its settings the text is longer than {_LONGEST_TEXT:,} characters"
            raise self.problem(node.at, path, found, "shorten it")
        return DocumentNode(replaced, node.at, node.key_at)

    def replacement(self, match: re.Match[str], at: Location, path: KeyPath) -> str:
        if match[0] == "$${":
            return "${"
        if match[1] is None:
            raise self.problem(at, path, "`${` without `}`", "close it, or write `$${` for `${`")
        name = match[1].strip()
        if name == "here":
            return str(at.folder)
        value = self.value(name, at, path).value
        if value is None or isinstance(value, Mapping | tuple):
            kind = "" if name.startswith(f"{FRAMES}.") else "the setting "
            found = f"{kind}{name} is not a text, number or boolean, so it has no text"
            raise self.problem(at, path, found, "refer to a text, number or boolean")
        return str(value).lower() if isinstance(value, bool) else str(value)

    def value(self, name: str, at: Location, path: KeyPath) -> DocumentNode:
        section, _, frame = name.partition(".")
        if section == FRAMES and frame:
            return self.frame(frame, at, path)
        steps = tuple(name.split("."))
        if self.settings.find(*steps) is None:
            known = [".".join(known) for known in self.settings.key_paths()]
            raise self.problem(at, path, f"there is no setting {name}", suggestion(name, known))
        within = [one[: len(steps)] == steps for one in self.in_progress]
        cycle = within.index(True) if True in within else None
        if cycle is not None:
            chain = " -> ".join(".".join(one) for one in [*self.in_progress[cycle:], steps])
            found = f"circular settings: {chain}"
            raise self.problem(at, path, found, "give one of them a value")
        node = self.setting(steps)
        if node is None:
            raise _UnresolvedError
        return node

    def frame(self, name: str, at: Location, path: KeyPath) -> DocumentNode:
        if self.frames is None:
            found = f"a reference to the frame {name} among what the frames may depend on"
            raise self.problem(at, path, found, "refer to frames below components only")
        try:
            node = self.frames.value(name, at)
        except CairnError as error:
            found, _, remedy = str(error).rpartition("; ")
            raise self.problem(at, path, found, remedy) from error
        if node is None:
            raise _UnresolvedError
        return node

    def problem(self, at: Location, path: KeyPath, found: str, remedy: str) -> _UnresolvedError:
        self.problems.append(Problem(at, dotted(path), found, remedy))
        return _UnresolvedError()

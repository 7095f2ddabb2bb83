"""The component tree inside a document, before anything is known to be right about it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cairn.deployment.document import Node, Steps
from cairn.deployment.problems import Location
from cairn.runtime.ports import PortSpec

if TYPE_CHECKING:
    from cairn.runtime.component import Component


@dataclass(frozen=True)
class Placed:
    """A component of the document with its plugin's class and ports, as far as they are known."""

    name: str
    path: Steps
    node: Node
    cls: "type[Component] | None" = None
    ports: "dict[str, PortSpec] | None" = None

    def topic(self, port: str) -> str:
        """The topic that the port is given in the document."""
        node = self.node.find("topics", port)
        return node.value if node is not None and isinstance(node.value, str) else port

    def line(self, port: str) -> Location:
        """Where the port's topic is written, else where the plugin is."""
        node = self.node.find("topics", port) or self.node.find("plugin") or self.node
        return node.where


def components(root: Node) -> Iterator[tuple[str, Steps, Node]]:
    """Name, path and node of each component at any depth, in start order."""
    yield from _below(root, "components", ())


def _below(parent: Node, key: str, path: Steps) -> Iterator[tuple[str, Steps, Node]]:
    mapping = parent.find(key)
    if mapping is None:
        return
    for name, node in mapping.entries.items():
        place = (*path, key, name)
        yield name, place, node
        yield from _below(node, "children", place)

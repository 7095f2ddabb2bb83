"""The services by which ROS 2 tools see and change the life cycle of a supervisor's children.

They are those of managed nodes (`ros2 lifecycle`) and of containers of components
(`ros2 component`). The supervisor serves them for its children, because it decides on their states:
see `ChildGroup.hold`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from cairn.errors import CairnError
from cairn.runtime.lifecycle import LifecycleState, Transition, possible_transitions, ros_state
from cairn.runtime.node_services import NodeService
from cairn.schemas.composition_interfaces.srv import ListNodes, LoadNode, UnloadNode
from cairn.schemas.lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)

Request = Callable[[str, Mapping[str, Any]], Any]
"""Makes one of a supervisor's own requests (`load`, `unload`, `hold`), or raises `CairnError`."""

_HELD: Final = {
    Transition.CONFIGURE: LifecycleState.INACTIVE,
    Transition.ACTIVATE: LifecycleState.ACTIVE,
    Transition.DEACTIVATE: LifecycleState.INACTIVE,
    Transition.CLEANUP: LifecycleState.UNCONFIGURED,
}


@dataclass(frozen=True)
class ChildLifecycle:
    """The life cycle of one child of a supervisor; `state` returns the state of that child."""

    name: str
    state: Callable[[], str]
    request: Request

    def services(self) -> list[NodeService]:
        """Return the services, which belong to the child's node."""
        return [
            NodeService("change_state", ChangeState, self._change_state),
            NodeService("get_state", GetState, self._get_state),
            NodeService("get_available_states", GetAvailableStates, self._states),
            NodeService("get_available_transitions", GetAvailableTransitions, self._transitions),
            NodeService("get_transition_graph", GetAvailableTransitions, self._graph),
        ]

    def _lifecycle_state(self) -> LifecycleState | None:
        state = self.state()
        return LifecycleState(state) if state in set(LifecycleState) else None

    def _change_state(self, request: ChangeState.Request) -> ChangeState.Response:
        state = self._lifecycle_state()
        for described in possible_transitions(state) if state is not None else ():
            wanted, one = request.transition, described.transition
            if wanted.id == one.id if wanted.id else wanted.label == one.label:
                transition = Transition(one.label)
                break
        else:
            raise CairnError(
                f"{self.name} is {self.state()}: it cannot make transition "
                f"{request.transition.id} {request.transition.label[:100]!r}"
            )
        if transition is Transition.SHUTDOWN:
            self.request("unload", {"name": self.name})
        else:
            self.request("hold", {"name": self.name, "state": _HELD[transition].value})
        return ChangeState.Response(success=True)

    def _get_state(self, _: GetState.Request) -> GetState.Response:
        return GetState.Response(current_state=ros_state(self.state()))

    def _states(self, _: GetAvailableStates.Request) -> GetAvailableStates.Response:
        states = tuple(ros_state(state) for state in LifecycleState)
        return GetAvailableStates.Response(available_states=states)

    def _transitions(self, _: GetAvailableTransitions.Request) -> GetAvailableTransitions.Response:
        state = self._lifecycle_state()
        found = possible_transitions(state) if state is not None else []
        return GetAvailableTransitions.Response(available_transitions=tuple(found))

    def _graph(self, _: GetAvailableTransitions.Request) -> GetAvailableTransitions.Response:
        return GetAvailableTransitions.Response(available_transitions=tuple(possible_transitions()))


@dataclass(frozen=True)
class Container:
    """A supervisor as a container of its children, which its deployment defines.

    `plugins` has the plugin of each child, by its name.
    """

    robot: str
    plugins: Mapping[str, str]
    is_loaded: Callable[[str], bool]
    request: Request

    @property
    def _names(self) -> list[str]:
        """The children in the order of the deployment; their numbers in ROS 2 begin with 1."""
        return list(self.plugins)

    def services(self) -> list[NodeService]:
        """Return the services, which belong to the supervisor's node."""
        return [
            NodeService("_container/list_nodes", ListNodes, self._list),
            NodeService("_container/load_node", LoadNode, self._load),
            NodeService("_container/unload_node", UnloadNode, self._unload),
        ]

    def _list(self, _: ListNodes.Request) -> ListNodes.Response:
        loaded = [
            (number, name) for number, name in enumerate(self._names, 1) if self.is_loaded(name)
        ]
        return ListNodes.Response(
            full_node_names=tuple(f"/{self.robot}/{name}" for _, name in loaded),
            unique_ids=[number for number, _ in loaded],  # type: ignore[arg-type]
        )

    def _load(self, request: LoadNode.Request) -> LoadNode.Response:
        name = request.node_name or request.plugin_name
        try:
            if name not in self.plugins:
                raise CairnError(
                    f"there is no child {name[:100]!r} to load; the deployment has "
                    f"{', '.join(self._names) or 'none'}"
                )
            if request.plugin_name not in ("", self.plugins[name], name):
                raise CairnError(
                    f"child {name} has plugin {self.plugins[name]}, not "
                    f"{request.plugin_name[:100]!r}"
                )
            if request.parameters or request.remap_rules or request.extra_arguments:
                raise CairnError(
                    "parameters, remapping and extra arguments are those of the deployment; change "
                    "them there"
                )
            self.request("load", {"name": name})
        except CairnError as error:
            return LoadNode.Response(success=False, error_message=str(error)[:4000])
        return LoadNode.Response(
            success=True,
            full_node_name=f"/{self.robot}/{name}",
            unique_id=self._names.index(name) + 1,
        )

    def _unload(self, request: UnloadNode.Request) -> UnloadNode.Response:
        number = request.unique_id
        try:
            if not 1 <= number <= len(self._names) or not self.is_loaded(self._names[number - 1]):
                raise CairnError(f"no child with id {number} is loaded; list_nodes lists them")
            self.request("unload", {"name": self._names[number - 1]})
        except CairnError as error:
            return UnloadNode.Response(success=False, error_message=str(error)[:4000])
        return UnloadNode.Response(success=True)

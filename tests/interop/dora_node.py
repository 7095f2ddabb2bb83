"""A node of dora-rs, an independent implementation of rmw_zenoh in Rust, in a process of its own.

`dora_node.py CONFIG NAME` reads a Zenoh configuration and obeys lines of JSON, each with one
answer. AMENT_PREFIX_PATH is a folder that `cairn schema export` wrote: dora reads definitions and
type descriptions there.
"""

import json
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import dora as dora_module
import numpy as np
import pyarrow as pa

from cairn.schemas.interfaces import interface
from cairn.schemas.message import Field, fields_of

dora: Any = dora_module  # its stub lacks what is used here

_PRIMITIVES = {
    "bool": pa.bool_(), "byte": pa.uint8(), "string": pa.string(),
    "float32": pa.float32(), "float64": pa.float64(),
    **{f"{sign}int{bits}": getattr(pa, f"{sign}int{bits}")()
       for sign in ("", "u") for bits in (8, 16, 32, 64)},
}  # fmt: skip


def arrow_type(cls: type[Any]) -> pa.DataType:
    """Return the Arrow structure of a message class."""
    return pa.struct([(field.name, _field_type(field)) for field in fields_of(cls)])


def _field_type(field: Field) -> pa.DataType:
    element = field.element
    one = arrow_type(element) if isinstance(element, type) else _PRIMITIVES[element]
    return one if field.count is None else pa.list_(one)


class Node:
    """The node with its endpoints, by name."""

    def __init__(self, config: str, name: str) -> None:
        warnings.simplefilter("ignore")
        context = dora.Ros2Context(
            [os.environ["AMENT_PREFIX_PATH"]],
            transport=dora.Ros2Transport.zenoh("rep2016", config),
        )
        self._context = context
        self._node = context.new_node(name, "/ros", dora.Ros2NodeOptions(rosout=False))
        # dora finds only servers whose announced QoS equals this one: that of ROS 2's services.
        self._services = dora.Ros2QosPolicies(reliable=True, keep_last=10)
        self._ends: dict[str, Any] = {}
        self._types: dict[str, Any] = {}

    def publish(self, topic: str, type: str, value: dict[str, Any], reliable: bool) -> None:
        """Publish a message; the first time, advertise the topic."""
        if topic not in self._ends:
            qos = dora.Ros2QosPolicies(reliable=reliable, keep_last=10)
            found = self._node.create_topic(topic, type.replace("/msg/", "/"), qos)
            self._ends[topic] = self._node.create_publisher(found, qos)
        self._ends[topic].publish(_array(interface(type), value))

    def subscribe(
        self,
        topic: str,
        type: str,
        reliable: bool,
        latched: bool = False,
    ) -> None:
        """Subscribe to a topic."""
        kind = dora.Ros2Durability.TransientLocal if latched else dora.Ros2Durability.Volatile
        qos = dora.Ros2QosPolicies(durability=kind, reliable=reliable, keep_last=10)
        found = self._node.create_topic(topic, type.replace("/msg/", "/"), qos)
        self._ends[topic] = self._node.create_subscription(found, qos)

    def receive(self, topic: str) -> Any:
        """Return the next message, None if there is none yet."""
        found = self._ends[topic].next()
        return None if found is None else _plain(found)

    def relay(self, source: str, target: str, type: str, reliable: bool) -> None:
        """Publish on one topic what arrives on another one, from now on."""
        self.subscribe(source, type, reliable)
        qos = dora.Ros2QosPolicies(reliable=reliable, keep_last=10)
        topic = self._node.create_topic(target, type.replace("/msg/", "/"), qos)
        subscription, publisher = self._ends[source], self._node.create_publisher(topic, qos)

        def relay() -> None:
            while True:
                found = subscription.next()
                if found is None:
                    time.sleep(0.002)
                else:
                    publisher.publish(found)

        threading.Thread(target=relay, daemon=True).start()

    def service_client(self, name: str, type: str) -> None:
        """Make a client, which waits for the server."""
        self._types[name] = interface(type)
        self._ends[name] = self._node.create_service_client(
            name, type.replace("/srv/", "/"), self._services
        )

    def call(self, name: str, request: dict[str, Any]) -> Any:
        """Call a service and return the response."""
        array = _array(self._types[name].Request, request)
        return _plain(self._ends[name].call(array, timeout_s=30.0))

    def serve_sums(self, name: str) -> None:
        """Serve example_interfaces/srv/AddTwoInts from now on."""
        server = self._node.create_service_server(
            name, "example_interfaces/AddTwoInts", self._services
        )

        def serve() -> None:
            while True:
                taken = server.take_request(timeout_s=1.0)
                if taken is not None:
                    number, request = taken
                    values = _plain(request)
                    server.send_response(number, pa.array([{"sum": values["a"] + values["b"]}]))

        threading.Thread(target=serve, daemon=True).start()

    def serve_fibonacci(self, name: str) -> None:
        """Serve example_interfaces/action/Fibonacci from now on: ten numbers per second."""
        server = self._node.create_action_server(
            name, "example_interfaces/Fibonacci", self._services
        )
        structure = pa.struct([("sequence", pa.list_(pa.int32()))])

        def sequence(numbers: list[int]) -> Any:
            return pa.array([{"sequence": numbers}], type=structure)

        def serve() -> None:
            while True:
                taken = server.take_goal(timeout_s=1.0)
                if taken is None:
                    continue
                identity, goal = taken
                numbers, status = [0, 1], "succeeded"
                while len(numbers) <= _plain(goal)["order"]:
                    if server.take_cancel(timeout_s=0.05):
                        status = "canceled"
                        break
                    numbers.append((numbers[-1] + numbers[-2]) % 1_000_000)
                    server.send_feedback(identity, sequence(numbers))
                    time.sleep(0.05)
                server.send_result(identity, sequence(numbers), status=status, timeout_s=30.0)

        threading.Thread(target=serve, daemon=True).start()

    def action_client(self, name: str, type: str) -> None:
        """Make a client of an action."""
        self._types[name] = interface(type)
        self._ends[name] = self._node.create_action_client(
            name, type.replace("/action/", "/"), self._services
        )

    def send_goal(self, name: str, goal: dict[str, Any]) -> str | None:
        """Send a goal; return its id, None if it is rejected."""
        identity: str | None = self._ends[name].send_goal(
            _array(self._types[name].Goal, goal), timeout_s=30.0
        )
        return identity

    def feedback(self, name: str, goal: str, timeout_s: float) -> Any:
        """Return the next feedback, None if none arrives in time."""
        found = self._ends[name].take_feedback(goal, timeout_s=timeout_s)
        return None if found is None else _plain(found)

    def result(self, name: str, goal: str) -> Any:
        """Return the final status and the result."""
        status, result = self._ends[name].take_result(goal, timeout_s=120.0)
        return [status, _plain(result)]

    def cancel(self, name: str, goal: str) -> int:
        """Cancel a goal; return the code of `action_msgs/srv/CancelGoal`."""
        return int(self._ends[name].cancel(goal, timeout_s=30.0))


def _array(cls: type[Any], value: dict[str, Any]) -> Any:
    return pa.array([value], type=arrow_type(cls))


def _plain(array: Any) -> Any:
    found = array.to_pylist()[0]
    return json.loads(json.dumps(found, default=_number))


def _number(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def main() -> None:
    """Obey until the input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # of what dora prints
    node = Node(sys.argv[1], sys.argv[2])
    for line in sys.stdin:
        verb, arguments = json.loads(line)
        method: Callable[..., Any] = getattr(node, verb)
        try:
            answer: Any = {"value": method(**arguments)}
        except Exception as error:
            answer = {"error": str(error).split("\n", 1)[0]}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()

"""An independent ROS 2 node over Zenoh in a process of its own: `ros2_client.py PORT DEFINITIONS`.

It is the package zenoh-ros2-sdk; DEFINITIONS is a directory of .msg files, so that it needs no
network. It obeys lines of JSON and answers each with one.
"""

import json
import os
import queue
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

LIMIT_S = 120.0


class Client:
    """The node's publishers, subscriptions, servers and clients."""

    def __init__(self, port: int, definitions: Path) -> None:
        # The SDK logs to its standard output otherwise, among the answers.
        os.environ["RCUTILS_LOGGING_SEVERITY"] = "ERROR"
        import zenoh_ros2_sdk as sdk

        self._sdk = sdk
        self._where = {"router_ip": "127.0.0.1", "router_port": port}
        self._session = sdk.ZenohSession.get_instance(**self._where)
        sdk.get_registry().messages_dir = definitions
        self._publishers: dict[str, Any] = {}
        self._received: dict[str, queue.Queue[Any]] = {}
        self._subscribers: list[Any] = []
        self._services: dict[str, Any] = {}

    def advertise(self, topic: str, type: str, node: str) -> None:
        self._publishers[topic] = self._sdk.ROS2Publisher(
            topic, type, node_name=node, namespace="/ros", **self._where
        )

    def subscribe(self, topic: str, type: str, node: str) -> None:
        received = self._received[topic] = queue.Queue()
        subscriber = self._sdk.ROS2Subscriber(
            topic, type, received.put, node_name=node, namespace="/ros", **self._where
        )
        self._subscribers.append(subscriber)

    def publish(self, topic: str, value: dict[str, Any]) -> None:
        publisher = self._publishers[topic]
        publisher.publish(**self._fields(publisher.msg_type, value))

    def has_subscribers(self, topic: str) -> bool:
        return bool(self._publishers[topic].pub.matching_status.matching)

    def receive(self, topic: str) -> Any:
        return _plain(self._received[topic].get(timeout=LIMIT_S))

    def service_client(self, name: str, type: str, node: str) -> None:
        self._services[name] = self._sdk.ROS2ServiceClient(
            name, type, node_name=node, namespace="/ros", timeout=LIMIT_S, **self._where
        )

    def has_server(self, name: str) -> bool:
        return bool(self._services[name].querier.matching_status.matching)

    def call(self, name: str, request: dict[str, Any]) -> Any:
        client = self._services[name]
        return _plain(client.call(**self._fields(client.request_store_type, request)))

    def serve_sums(self, name: str, node: str) -> None:
        def add(request: Any) -> Any:
            return server.response_msg_class(sum=request.a + request.b)

        server = self._services[name] = self._sdk.ROS2ServiceServer(
            name, "example_interfaces/srv/AddTwoInts", add, node_name=node, namespace="/ros",
            **self._where,
        )  # fmt: skip

    def topics(self) -> Any:
        return self._sdk.get_topic_names_and_types(**self._where)

    def info(self, topic: str) -> Any:
        info = self._sdk.get_topic_info(topic, verbose=True, **self._where)
        if info is None:
            return None
        ends = {"publishers": info.publishers, "subscribers": info.subscribers}
        return {
            kind: [[end.node_namespace, end.node_name, end.qos] for end in found]
            for kind, found in ends.items()
        }

    def services(self) -> Any:
        return self._sdk.get_service_names_and_types(**self._where)

    def servers(self, service: str) -> Any:
        info = self._sdk.get_service_info(service, verbose=True, **self._where)
        servers = [] if info is None else info.servers
        return [[one.node_namespace, one.node_name, one.type_hash, one.qos] for one in servers]

    def close(self) -> None:
        for end in (*self._publishers.values(), *self._subscribers, *self._services.values()):
            end.close()
        self._session.close()

    def _fields(self, name: str, value: dict[str, Any]) -> dict[str, Any]:
        store = self._session.store
        described = store.fielddefs[name][1]
        return {field: self._value(kind, value[field]) for field, kind in described}

    def _value(self, description: Any, value: Any) -> Any:
        node, detail = description
        if node.name == "NAME":
            return self._session.store.types[detail](**self._fields(detail, value))
        if node.name == "BASE":
            return value
        element, kind = detail[0][0], detail[0][1]
        if element.name == "NAME":
            return [self._value(detail[0], one) for one in value]
        return value if kind[0] == "string" else np.array(value, dtype=np.dtype(kind[0]))


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {
            field.name: _plain(getattr(value, field.name))
            for field in fields(value)
            if not field.name.startswith("_")
        }
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value


def main() -> None:
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    sys.stdout = sys.stderr
    client = Client(int(sys.argv[1]), Path(sys.argv[2]))
    for line in sys.stdin:
        verb, arguments = json.loads(line)
        answers.write(json.dumps(getattr(client, verb)(**arguments)) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()

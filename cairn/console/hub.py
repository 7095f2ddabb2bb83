"""The hub: passes channels, messages, calls and events between a source and browsers."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import secrets
from collections import defaultdict
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib.metadata import version
from typing import Any, Final, Literal

from pydantic import ValidationError

from cairn.console import protocol
from cairn.console.browser import MAX_SUBSCRIPTIONS, Browser, BrowserSubscription, Send
from cairn.console.images import IMAGE_TYPE, to_jpeg
from cairn.console.operations import ConsoleMethod, ConsoleOperations, Operations
from cairn.console.protocol import ERROR, INFO, WARNING, ProtocolError, to_text
from cairn.console.source import Channel, ConnectionGraph, Message, Source
from cairn.errors import CairnError
from cairn.limits.json import parse_json
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import type_name

MAX_BROWSERS: Final = 24
PING: Final = "ping"
"""Method that does nothing: its answer shows that the link is alive."""
_MAX_INVALID: Final = 20  # messages of one browser
_MAX_CALLS: Final = 32  # of one browser that are under way
_MAX_CLIENT_CHANNELS: Final = 100
_ENCODER_THREADS: Final = 2
_CALL_LIMIT_S: Final = 120.0  # longer than a component takes to stop and to start
_STATUS_TYPE: Final = type_name(ComponentStatus)

_log = logging.getLogger("cairn.console")


class TooManyBrowsers(CairnError):
    """No further browser is accepted."""


class Hub:
    """Serves any number of browsers from one source. For the event loop's thread.

    Attributes:
        source: where channels and messages come from.
        may: what browsers may do.
        why_watch: why they may watch only, if that is so.
        operations: the methods.
        browsers: those that are connected.
        channels: those that exist now, by id.
        graph: who publishes and subscribes which topic now.
    """

    def __init__(
        self,
        source: Source,
        may: Literal["watch", "steer"] = "steer",
        operations: Callable[[Hub], ConsoleOperations] = Operations,
    ) -> None:
        self.source = source
        self.may = may
        self.why_watch = "this console may watch only"
        self.browsers: set[Browser] = set()
        self.channels: dict[int, Channel] = {}
        self.graph = ConnectionGraph({}, {})
        self._session_id = secrets.token_hex(8)
        self._ids = itertools.count(1)
        self._subscribed: defaultdict[int, dict[BrowserSubscription, Browser]] = defaultdict(dict)
        self._encoders = ThreadPoolExecutor(_ENCODER_THREADS, "cairn jpeg")
        self._images: dict[int, _Encoding] = {}
        self._tasks: set[asyncio.Task[Any]] = set()
        self._link: dict[str, Any] = {"connected": source.mode == "recording", "reason": ""}
        self.operations = operations(self)
        self._services: dict[int, tuple[str, str, ConsoleMethod]] = {}  # robot, method
        self._service_ids: dict[tuple[str, str], int] = {}

    # What a source calls

    async def run(self) -> None:
        """Run the source and the operations until canceled."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self.source.run(self))
            group.create_task(self.operations.run())

    @property
    def robots(self) -> list[str]:
        """Names of the robots whose components are on the bus or in the recording."""
        return sorted(
            {one.robot for one in self.channels.values() if one.type_name == _STATUS_TYPE}
        )

    def set_channels(self, channels: Iterable[Channel]) -> None:
        """Take over the channels that exist now; browsers receive what has changed."""
        before, robots = self.channels, self.robots
        self.channels = {channel.id: channel for channel in channels}
        removed = [id_ for id_ in before if id_ not in self.channels]
        added = [one for one in self.channels.values() if one.id not in before]
        for id_ in removed:
            for subscription, browser in list(self._subscribed[id_].items()):
                self._end(browser, subscription)
        for browser in self.browsers:
            if removed:
                browser.send({"op": "unadvertise", "channelIds": removed})
            if added:
                browser.send(protocol.advertise(added))
        if robots != self.robots:
            self._update_services()
            self.broadcast("robots", self.robots)

    def set_graph(self, graph: ConnectionGraph) -> None:
        """Take over who publishes and subscribes which topic; browsers receive what has changed."""
        before, self.graph = self.graph, graph
        change = protocol.graph_change(before, graph)
        if change == protocol.NO_GRAPH_CHANGE:
            return
        for browser in self.browsers:
            if browser.wants_graph:
                browser.send(change)

    def set_link(self, reason: str = "") -> None:
        """Report that the link to the bus is there, or the reason why it is not."""
        link = {"connected": not reason, "reason": reason}
        if link == self._link:
            return
        self._link = link
        self.broadcast("link", link)
        for browser in self.browsers:
            if not browser.is_console:
                browser.send_status(WARNING if reason else INFO, reason or "connected")
        if reason:
            _log.warning("not connected to the robot: %s", reason)

    def deliver(self, channel: int, message: Message) -> None:
        """Pass a message on to all browsers that subscribe to its channel."""
        images = []
        for subscription, browser in self._subscribed.get(channel, {}).items():
            if subscription.jpeg:
                images.append((browser, subscription))
            else:
                browser.offer(subscription, message)
        if images:
            self._encode(channel, message, images)

    # What operations call

    def broadcast(self, name: str, value: Any, *, key: str = "") -> None:
        """Send an event to all consoles.

        A browser that is slow receives only the newest one of each key, by default the name.
        """
        text = protocol.event(name, value)
        for browser in self.browsers:
            browser.send_event(name, text, key)

    def send_event(self, browser: Browser, name: str, value: Any, *, key: str = "") -> None:
        """Send an event to one console."""
        browser.send_event(name, protocol.event(name, value), key)

    def broadcast_time(self, time_ns: int) -> None:
        """Send the time of a recording that is played to all clients of Foxglove."""
        data = protocol.time_data(time_ns)
        for browser in self.browsers:
            if not browser.is_console:
                browser.send_binary(data)

    def parameters_changed(self, robot: str, component: str, values: Mapping[str, Any]) -> None:
        """Report parameters that were changed to those clients of Foxglove that asked for it."""
        prefix = self._parameter_prefix(robot)
        changed = {f"{prefix}{component}.{name}": value for name, value in values.items()}
        for browser in self.browsers:
            wanted = browser.parameter_names
            shown = {
                name: value for name, value in changed.items() if wanted is None or name in wanted
            }
            if shown:
                browser.send(protocol.parameter_values(shown))

    def restrict(self, reason: str) -> None:
        """Let browsers only watch from now on, for that reason."""
        self.may = "watch"
        self.why_watch = reason
        for browser in self.browsers:
            browser.may = "watch"
            self._send_hello(browser)

    # Browsers

    async def serve(
        self,
        subprotocol: str,
        receive: Callable[[], Awaitable[str | bytes | None]],
        send: Send,
    ) -> tuple[int, str]:
        """Serve a browser until it ends; return code and reason to close the connection.

        Raises `TooManyBrowsers` if there is no room for it.
        """
        if len(self.browsers) >= MAX_BROWSERS:
            raise TooManyBrowsers(
                f"{MAX_BROWSERS} browsers are connected already; close one of their pages"
            )
        browser = Browser(next(self._ids), subprotocol, self.may, send)
        self._greet(browser)
        self.browsers.add(browser)
        self.operations.connected(browser)
        reading = asyncio.create_task(self._read(browser, receive))
        sending = asyncio.create_task(browser.pump())
        try:
            done, _ = await asyncio.wait((reading, sending), return_when=asyncio.FIRST_COMPLETED)
            if reading in done:
                return reading.result()
            return 1013, sending.result()
        finally:
            self.browsers.discard(browser)
            for task in (reading, sending):
                task.cancel()
                with suppress(asyncio.CancelledError, Exception):
                    await task
            for subscription in list(browser.subscriptions.values()):
                self._end(browser, subscription)
            self.operations.disconnected(browser)

    def _greet(self, browser: Browser) -> None:
        is_live = self.source.mode == "live"
        live = ["clientPublish", "parameters", "parametersSubscribe", "services"]
        browser.send(
            {
                "op": "serverInfo",
                "name": "Cairn console",
                "capabilities": ["connectionGraph", *(live if is_live else ["time"])],
                "supportedEncodings": ["cdr", "json"],
                "metadata": {"ROS_DISTRO": "jazzy", "cairn": version("cairn-robotics")},
                "sessionId": self._session_id,
            }
        )
        self._send_hello(browser)
        self.send_event(browser, "link", self._link)
        browser.send(protocol.advertise(list(self.channels.values())))
        if not browser.is_console:
            if self._services:
                browser.send(self._advertised_services(self._services))
            if not self._link["connected"]:
                browser.send_status(WARNING, self._link["reason"])

    def _send_hello(self, browser: Browser) -> None:
        hello = {
            "version": version("cairn-robotics"),
            "mode": self.source.mode,
            "robots": self.robots,
            "may": browser.may,
            "recording": self.source.recording,
        }
        self.send_event(browser, "hello", hello)

    async def _read(
        self, browser: Browser, receive: Callable[[], Awaitable[str | bytes | None]]
    ) -> tuple[int, str]:
        while (data := await receive()) is not None:
            if len(data) > protocol.LONGEST_FRAME:
                limit = protocol.LONGEST_FRAME >> 20
                return 1009, f"a message of {len(data):,} bytes; at most {limit} MiB are accepted"
            try:
                if isinstance(data, bytes):
                    self._handle_binary(browser, protocol.parse_binary(data))
                else:
                    self._handle(browser, protocol.parse_text(data))
            except ProtocolError as error:
                browser.invalid += 1
                if browser.invalid > _MAX_INVALID:
                    return 1008, f"too many invalid messages; the last one: {error}"
                browser.send_status(ERROR, str(error))
            await asyncio.sleep(0)  # one that sends without end does not hold up the others
        return 1000, ""

    def _handle(self, browser: Browser, request: protocol.Request) -> None:
        match request:
            case protocol.Subscribe():
                for one in request.subscriptions:
                    self.subscribe(browser, one)
            case protocol.Unsubscribe():
                for id_ in request.subscription_ids:
                    self.unsubscribe(browser, id_)
            case protocol.CallMethod():
                self._spawn(browser, self._call(browser, request))
            case protocol.Advertise():
                for channel in request.channels:
                    self._advertise_client(browser, channel)
            case protocol.Unadvertise():
                for id_ in request.channel_ids:
                    browser.client_channels.pop(id_, None)
            case protocol.GetParameters():
                self._spawn(browser, self._get_parameters(browser, request))
            case protocol.SetParameters():
                self._spawn(browser, self._set_parameters(browser, request))
            case protocol.SubscribeParameters():
                if not request.parameter_names:
                    browser.parameter_names = None
                elif browser.parameter_names is not None:
                    browser.parameter_names.update(request.parameter_names)
                    if len(browser.parameter_names) > 10_000:
                        browser.parameter_names = None
            case protocol.UnsubscribeParameters():
                known = browser.parameter_names or set()
                names = request.parameter_names
                browser.parameter_names = known.difference(names) if names else set()
            case protocol.SubscribeGraph():
                browser.wants_graph = True
                browser.send(protocol.graph_change(ConnectionGraph({}, {}), self.graph))
            case protocol.UnsubscribeGraph():
                browser.wants_graph = False
            case protocol.FetchAsset():
                reason = f"{request.uri}: this server has no files"
                browser.send_binary(protocol.asset_refusal(request.request_id, reason))

    def _handle_binary(
        self, browser: Browser, data: protocol.ClientData | protocol.ServiceCall
    ) -> None:
        if isinstance(data, protocol.ServiceCall):
            self._spawn(browser, self._call_service(browser, data))
            return
        channel = browser.client_channels.get(data.channel)
        if channel is None:
            raise ProtocolError(f"channel {data.channel} is not advertised by this client")
        self._spawn(browser, self._publish(browser, channel, data.payload))

    def _spawn(self, browser: Browser, work: Coroutine[Any, Any, None]) -> None:
        """Run what takes time beside the reading of further messages."""
        if browser.calls >= _MAX_CALLS:
            work.close()
            raise ProtocolError(f"busy: {_MAX_CALLS} calls of this client are under way")
        browser.calls += 1
        task = asyncio.create_task(work)
        self._tasks.add(task)

        def end(task: asyncio.Task[None]) -> None:
            browser.calls -= 1
            self._tasks.discard(task)
            if not task.cancelled() and task.exception() is not None:
                _log.error("a call failed", exc_info=task.exception())

        task.add_done_callback(end)

    # Subscriptions

    def subscribe(self, browser: Browser, request: protocol.SubscribeRequest) -> None:
        """Begin a subscription of a browser."""
        channel = self.channels.get(request.channel_id)
        if channel is None:
            browser.send_status(
                WARNING, f"there is no channel {request.channel_id}, or no longer; not subscribed"
            )
            return
        if request.id in browser.subscriptions:
            browser.send_status(ERROR, f"subscription {request.id} exists already; unsubscribe it")
            return
        if len(browser.subscriptions) >= MAX_SUBSCRIPTIONS:
            raise ProtocolError(f"a client may have at most {MAX_SUBSCRIPTIONS} subscriptions")
        if request.jpeg and channel.type_name != IMAGE_TYPE:
            raise ProtocolError(f"{channel.topic} has no images of {IMAGE_TYPE} to send as JPEG")
        subscription = BrowserSubscription(
            request.id, channel, max_hz=request.max_hz, jpeg=request.jpeg
        )
        browser.subscriptions[request.id] = subscription
        subscribers = self._subscribed[channel.id]
        subscribers[subscription] = browser
        if len(subscribers) == 1:
            self.source.subscribe(channel)
        elif channel.latched:
            for message in self.source.kept(channel):
                if subscription.jpeg:
                    self._encode(channel.id, message, [(browser, subscription)])
                else:
                    browser.offer(subscription, message)

    def unsubscribe(self, browser: Browser, subscription_id: int) -> None:
        """End a subscription of a browser, if it has one with that id."""
        if subscription_id in browser.subscriptions:
            self._end(browser, browser.subscriptions[subscription_id])

    def _end(self, browser: Browser, subscription: BrowserSubscription) -> None:
        """End a subscription, and that of the source if it was the last one."""
        browser.remove(subscription.id)
        channel = subscription.channel
        subscribers = self._subscribed[channel.id]
        if subscribers.pop(subscription, None) is not None and not subscribers:
            del self._subscribed[channel.id]
            self.source.unsubscribe(channel)

    def _encode(
        self, channel: int, message: Message, wanted: Sequence[tuple[Browser, BrowserSubscription]]
    ) -> None:
        """Encode an image on another thread, once for all browsers that have room for it."""
        now = asyncio.get_running_loop().time()
        # A slow browser has one image waiting: it gets the newest one when that is sent.
        free = [(browser, one) for browser, one in wanted if one.is_free(now)]
        if not free:
            for _, one in wanted:
                one.dropped += 1
            return
        encoding = self._images.get(channel)
        if encoding is not None:
            encoding.next = (message, free)  # the newest one wins
            return
        self._images[channel] = encoding = _Encoding()
        task = asyncio.create_task(self._encode_all(channel, encoding, message, free))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _encode_all(
        self,
        channel: int,
        encoding: _Encoding,
        message: Message,
        wanted: Sequence[tuple[Browser, BrowserSubscription]],
    ) -> None:
        loop = asyncio.get_running_loop()
        try:
            while True:
                try:
                    jpeg = await loop.run_in_executor(self._encoders, to_jpeg, message.payload)
                except CairnError as error:
                    for browser, subscription in wanted:
                        if not subscription.has_failed:
                            browser.send_status(ERROR, f"{subscription.channel.topic}: {error}")
                        subscription.has_failed = True
                else:
                    for browser, subscription in wanted:
                        browser.offer(subscription, message._replace(payload=jpeg))
                if encoding.next is None:
                    return
                (message, wanted), encoding.next = encoding.next, None
        finally:
            del self._images[channel]

    # Calls

    async def _call(self, browser: Browser, request: protocol.CallMethod) -> None:
        answer: dict[str, Any] = {"op": "result", "id": request.id}
        try:
            answer["value"] = await self._result(browser, request.method, request.arguments)
        except CairnError as error:
            answer["error"] = str(error)
        browser.send(answer)

    async def _result(self, browser: Browser, name: str, arguments: Mapping[str, Any]) -> Any:
        """Call a method and return its value; `CairnError` says why it failed."""
        if name == PING:
            return None
        method = self.operations.methods.get(name)
        if method is None:
            known = ", ".join(sorted(self.operations.methods))
            raise CairnError(f"there is no method {name}; there are: {known}")
        if method.changes and browser.may == "watch":
            raise CairnError(f"{name} is refused: {self.why_watch}")
        try:
            valid = method.arguments.model_validate(dict(arguments))
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            where = ".".join(map(str, first["loc"]))
            raise CairnError(f"{name}: {where or 'arguments'}: {first['msg']}"[:500]) from None
        try:
            async with asyncio.timeout(_CALL_LIMIT_S):
                value = await method.call(browser, valid)
        except TimeoutError as error:
            raise CairnError(f"{name}: no answer within {_CALL_LIMIT_S:g} s") from error
        try:
            return json.loads(json.dumps(value, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise CairnError(f"{name}: its answer cannot be sent: {error}") from error

    # Clients of Foxglove

    async def _call_service(self, browser: Browser, call: protocol.ServiceCall) -> None:
        try:
            known = self._services.get(call.service)
            if known is None:
                raise CairnError(f"there is no service {call.service}, or no longer")
            if call.encoding != "json":
                raise CairnError(f"services take JSON, not {call.encoding!r}")
            robot, name, _ = known
            try:
                arguments = parse_json(call.payload or b"{}", protocol.LONGEST_TEXT)
            except ValueError as error:
                raise CairnError(f"{name}: the request is not JSON: {error}") from error
            if not isinstance(arguments, dict):
                raise CairnError(f"{name}: the request must be a JSON object")
            value = await self._result(browser, name, {**arguments, "robot": robot})
        except CairnError as error:
            browser.send(
                {
                    "op": "serviceCallFailure",
                    "serviceId": call.service,
                    "callId": call.call,
                    "message": str(error),
                }
            )
            return
        answer = value if isinstance(value, dict) else {"value": value}
        browser.send_binary(protocol.service_response(call, to_text(answer).encode()))

    def _update_services(self) -> None:
        """Offer methods as services of the robots that exist now."""
        wanted = {
            (robot, name): method
            for robot in self.robots
            for name, method in self.operations.methods.items()
            if method.is_service
        }
        before = self._services
        self._services = {}
        for key, method in wanted.items():
            id_ = self._service_ids.setdefault(key, len(self._service_ids) + 1)
            self._services[id_] = (*key, method)
        removed = [id_ for id_ in before if id_ not in self._services]
        added = {id_: one for id_, one in self._services.items() if id_ not in before}
        for browser in self.browsers:
            if not browser.is_console and removed:
                browser.send({"op": "unadvertiseServices", "serviceIds": removed})
            if not browser.is_console and added:
                browser.send(self._advertised_services(added))

    def _advertised_services(
        self, services: Mapping[int, tuple[str, str, ConsoleMethod]]
    ) -> dict[str, Any]:
        return {
            "op": "advertiseServices",
            "services": [
                protocol.service(id_, robot, name, _without_robot(method))
                for id_, (robot, name, method) in services.items()
            ],
        }

    def _advertise_client(self, browser: Browser, channel: protocol.ClientChannel) -> None:
        if len(browser.client_channels) >= _MAX_CLIENT_CHANNELS:
            raise ProtocolError(f"a client may advertise at most {_MAX_CLIENT_CHANNELS} channels")
        if self.source.mode != "live":
            raise ProtocolError(f"{channel.topic}: nothing can be published in a recording")
        if browser.may == "watch":
            raise ProtocolError(f"{channel.topic}: {self.why_watch}")
        if channel.encoding != "cdr":
            raise ProtocolError(f"{channel.topic}: publish as cdr, not {channel.encoding!r}")
        browser.client_channels[channel.id] = channel

    async def _publish(
        self, browser: Browser, channel: protocol.ClientChannel, payload: bytes
    ) -> None:
        parts = channel.topic.split("/")
        reason = self.operations.refusal(browser, parts[1] if len(parts) > 2 else "")
        try:
            if reason:
                raise CairnError(f"{channel.topic}: {reason}")
            await self.source.publish(channel.topic, channel.schema_name, payload)
        except CairnError as error:
            browser.send_status(ERROR, str(error))

    def _parameter_prefix(self, robot: str) -> str:
        """Return what precedes `component.parameter`: nothing if there is only one robot."""
        return "" if self.robots in ([robot], []) else f"{robot}/"

    def _component_of(self, parameter: str) -> tuple[str, str, str]:
        """Return robot, component and name of a parameter as clients of Foxglove name it."""
        robot, slash, rest = parameter.removeprefix("/").rpartition("/")
        component, dot, name = rest.partition(".")
        if not slash and len(self.robots) == 1:
            robot = self.robots[0]
        if not (robot and component and dot and name):
            raise CairnError(
                f"{parameter} is not a parameter; write component.parameter, or "
                "robot/component.parameter if there are several robots"
            )
        return robot, component, name

    async def _get_parameters(self, browser: Browser, request: protocol.GetParameters) -> None:
        wanted = set(request.parameter_names)
        try:
            if wanted:
                components = {self._component_of(name)[:2] for name in wanted}
            else:
                components = self._components()
        except CairnError as error:
            browser.send_status(ERROR, str(error))
            return
        results = await asyncio.gather(
            *(self._parameters_of(browser, *one) for one in sorted(components))
        )
        values = {
            name: value
            for part in results
            for name, value in part.items()
            if not wanted or name in wanted
        }
        browser.send(protocol.parameter_values(values, request.id))

    async def _parameters_of(self, browser: Browser, robot: str, component: str) -> dict[str, Any]:
        arguments = {"robot": robot, "component": component}
        try:
            entries = await self._result(browser, "parameters", arguments)
        except CairnError as error:
            browser.send_status(WARNING, str(error))
            return {}
        prefix = f"{self._parameter_prefix(robot)}{component}."
        return {f"{prefix}{entry['name']}": entry["value"] for entry in entries}

    async def _set_parameters(self, browser: Browser, request: protocol.SetParameters) -> None:
        changes: defaultdict[tuple[str, str], dict[str, Any]] = defaultdict(dict)
        values: dict[str, Any] = {}
        try:
            for parameter in request.parameters:
                robot, component, name = self._component_of(parameter.name)
                changes[robot, component][name] = parameter.value
        except CairnError as error:
            browser.send_status(ERROR, str(error))
            return
        for (robot, component), change in changes.items():
            arguments = {"robot": robot, "component": component, "values": change}
            try:
                await self._result(browser, "set_parameters", arguments)
            except CairnError as error:
                browser.send_status(ERROR, str(error))
            if request.id is not None:
                known = await self._parameters_of(browser, robot, component)
                prefix = f"{self._parameter_prefix(robot)}{component}."
                names = {f"{prefix}{name}" for name in change}
                values |= {name: value for name, value in known.items() if name in names}
        if request.id is not None:
            browser.send(protocol.parameter_values(values, request.id))

    def _components(self) -> set[tuple[str, str]]:
        """Return robot and name of all components: the nodes that publish a status."""
        topics = {one.topic for one in self.channels.values() if one.type_name == _STATUS_TYPE}
        nodes = {node for topic in topics for node in self.graph.publishers.get(topic, ())}
        parts = [node.split("/") for node in nodes]
        return {(one[1], one[2]) for one in parts if len(one) == 3}


class _Encoding:
    """An image that is being encoded, and the one that follows."""

    def __init__(self) -> None:
        self.next: tuple[Message, Sequence[tuple[Browser, BrowserSubscription]]] | None = None


def _without_robot(method: ConsoleMethod) -> dict[str, Any]:
    """Return the JSON schema of a method's arguments; the name of a service contains the robot."""
    schema = method.arguments.model_json_schema()
    properties = {
        name: one for name, one in schema.get("properties", {}).items() if name != "robot"
    }
    required = [name for name in schema.get("required", []) if name != "robot"]
    return {**schema, "properties": properties, "required": required}

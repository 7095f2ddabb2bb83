"""The services of a re-run: recorded calls, and answers and requests that are compared."""

from typing import TYPE_CHECKING, Any

from cairn.bus.bus import ClientOptions, OnFailure, OnReply, ServerOptions, check_response
from cairn.rerun.call_environment import Sent

if TYPE_CHECKING:
    from cairn.rerun.engine import Rerun


class RerunServer:
    """Receives the recorded calls of one service."""

    received = invalid = refused = 0

    def __init__(self, rerun: "Rerun", options: ServerOptions) -> None:
        self.name = options.name
        self.service = options.service
        self.codec = rerun.codec
        self._rerun = rerun
        self._wake = options.wake
        self._next: RerunCall | None = None
        self.port = rerun.open_server(self)

    def deliver(self, call: "RerunCall") -> None:
        """Have the component take a call."""
        self._next = call
        self._wake()

    def take(self) -> "RerunCall | None":
        """Return the call that is delivered, or taken within the call that is made again."""
        taken, self._next = self._next or self._rerun.pending_call(self), None
        return taken

    def close(self) -> None:
        """Receive no more calls."""
        self._rerun.close_service(self.port)

    def compare(self, what: str, sent: Sent) -> None:
        """Compare an answer or a refusal with the recording."""
        self._rerun.compare_sent(self.name, self.port, what, sent)


class RerunCall:
    """A recorded call; its answer is compared with the recorded one."""

    def __init__(self, server: RerunServer, request: Any, client: bytes, sequence: int) -> None:
        self.request = request
        self.client = client
        self.sequence = sequence
        self._server = server

    def reply(self, response: Any) -> None:
        """Compare a response; `TypeError` if it is not of the service's response class."""
        check_response(response, self._server.service.Response)
        self._send("an answer", self._server.codec.encode(response))

    def refuse(self, reason: str) -> None:
        """Compare a refusal."""
        self._send("a refusal", reason)

    def _send(self, what: str, content: bytes | str) -> None:
        self._server.compare(what, Sent(self.client, self.sequence, content))


class RerunClient:
    """Calls one service; the answers are those of the recording."""

    gid = bytes(16)

    def __init__(self, rerun: "Rerun", options: ClientOptions) -> None:
        self.name = options.name
        self.service = options.service
        self.sent = 0
        self.pending: dict[int, tuple[OnReply, OnFailure]] = {}
        self._rerun = rerun
        self._port = rerun.open_client(self)

    @property
    def is_available(self) -> bool:
        """Whether the component saw a server."""
        return self._rerun.saw_server(self._port)

    def call(
        self, request: Any, on_reply: OnReply, on_failure: OnFailure, timeout_s: float
    ) -> None:
        """Compare the request with the recording; the log says when it is answered."""
        del timeout_s
        self.sent += 1
        self.pending[self.sent] = (on_reply, on_failure)
        sent = Sent(bytes(16), self.sent, self._rerun.codec.encode(request))
        self._rerun.compare_sent(self.name, self._port, "a call", sent)

    def close(self) -> None:
        """Get no more answers."""
        self._rerun.close_service(self._port)

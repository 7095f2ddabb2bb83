"""Who may connect to the console, and what a hostile client gets."""

from __future__ import annotations

import socket
import ssl
import stat
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPConnection, HTTPSConnection
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from cairn import CairnError
from cairn.console import hub, server
from cairn.console.protocol import CONSOLE, LONGEST_FRAME
from cairn.console.server import Address, Console, token_in
from cairn.system import http_server
from cairn.testing.launching import free_port
from tests.cairn.console.conftest import TOKEN, FakeSource, Page, Running, running
from tests.patience import LIMIT_S
from tests.wording import words_in_order

FOXGLOVE = "https://app.foxglove.dev"


@pytest.fixture(scope="module")
def console() -> Iterator[Running]:
    with running(FakeSource(), address=Address(origins=(FOXGLOVE,))) as console:
        yield console


def get(console: Running, path: str, **headers: str) -> tuple[int, str, dict[str, str]]:
    """Return status, text and headers of the answer to a GET request."""
    connection = HTTPConnection("127.0.0.1", console.console.port, timeout=LIMIT_S)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text, {key.lower(): value for key, value in answer.getheaders()}


def closed_by(page: Page) -> tuple[int, str]:
    """Return code and reason with which the console closes a connection."""
    with pytest.raises(ConnectionClosed) as closed:
        page.text("nothing that comes")
    received = closed.value.rcvd
    assert received is not None
    return received.code, received.reason


def test_page_has_a_strict_policy(console: Running) -> None:
    status, text, headers = get(console, "/")

    assert status == 200
    assert "<html" in text
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "unsafe" not in headers["content-security-policy"]
    assert headers["x-frame-options"] == "DENY"
    assert get(console, "/../server.py")[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_other_host_names_are_refused_against_dns_rebinding(console: Running, host: str) -> None:
    status, text, _ = get(console, "/", Host=host)

    assert status == 403
    assert "certificate" in text


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_pages_of_other_sites_are_refused_and_no_error_is_logged(
    console: Running, origin: str, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        console.browser(origin=origin)

    assert refused.value.response.status_code == 403
    assert b"--allow-origin" in (refused.value.response.body or b"")
    assert get(console, "/")[0] == 200  # answered after all that the first request caused
    assert not caplog.records


def test_own_page_and_allowed_sites_may_connect(console: Running) -> None:
    for origin in (f"http://127.0.0.1:{console.console.port}", FOXGLOVE):
        page = console.browser(origin=origin)
        page.text("serverInfo")
        page.close()


@pytest.mark.parametrize("token", ["", "wrong", "token-of-the-test", "ö", "x" * 5000])
def test_wrong_token_is_closed_with_its_code(console: Running, token: str) -> None:
    code, reason = closed_by(console.browser(token=token))

    assert code == server.TOKEN_REFUSED
    assert "token" in reason


def test_unknown_subprotocol_is_refused_with_the_known_ones(console: Running) -> None:
    with pytest.raises(InvalidStatus) as refused:
        console.browser("rosbridge_v2")

    assert b"foxglove.sdk.v1" in (refused.value.response.body or b"")


def test_oversized_frame_closes_this_connection_only(console: Running) -> None:
    other, page = console.browser(), console.browser()

    page.socket.send(bytes(LONGEST_FRAME + 1))

    code, reason = closed_by(page)
    assert (code, "4 MiB" in reason) == (1009, True)
    assert "no method" in other.call("nothing")["error"]
    other.close()


EMPTY_MASK = b"\x80" + bytes(4)
FRAMES: dict[str, tuple[str, bytes, bytes]] = {  # token, first frame, frame that is repeated
    "pings": (TOKEN, b"", b"\x89" + EMPTY_MASK),
    "pongs": (TOKEN, b"", b"\x8a" + EMPTY_MASK),
    "fragments": (TOKEN, b"\x01" + EMPTY_MASK, b"\x00" + EMPTY_MASK),
    "pings of a stranger": ("wrong", b"", b"\x89" + EMPTY_MASK),
    "messages of a stranger": ("wrong", b"", b"\x81" + EMPTY_MASK),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames_without_end_close_this_connection_only(
    console: Running, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_CLOSE_LIMIT_S", 10 * LIMIT_S)  # so it is not that limit
    token, first, repeated = FRAMES[name]
    other = console.browser()

    with socket.create_connection(("127.0.0.1", console.console.port), LIMIT_S) as hostile:
        hostile.sendall(
            f"GET /ws?token={token} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            f"Sec-WebSocket-Protocol: {CONSOLE}\r\n\r\n".encode()
        )
        assert hostile.recv(12) == b"HTTP/1.1 101"
        with suppress(ConnectionError):
            hostile.sendall(first + repeated * 2_000)
        with suppress(ConnectionError):
            while hostile.recv(65_536):
                pass

    assert "no method" in other.call("nothing")["error"]
    other.close()


def test_message_in_fragments_and_pings_are_answered(console: Running) -> None:
    page = console.browser()
    text = '{"op": "call", "id": 5, "method": "nothing"}' + " " * 500

    for _ in range(50):
        page.socket.ping()
    page.socket.send(iter(text))

    assert "no method" in page.text("result", id=5)["error"]
    page.close()


def test_too_many_browsers_are_refused_with_the_reason(
    console: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hub, "MAX_BROWSERS", 1)
    page = console.browser()
    page.text("serverInfo")

    code, reason = closed_by(console.browser())

    assert (code, "close one" in reason) == (server.TRY_LATER, True)
    page.close()


def test_connection_that_sends_no_request_is_closed(
    console: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(http_server, "_REQUEST_LIMIT_S", 0.1)
    with socket.create_connection(("127.0.0.1", console.console.port), LIMIT_S) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: ")

        assert slow.recv(1) == b""


def test_second_console_takes_another_port_unless_others_look_for_it_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = free_port()
    monkeypatch.setattr(server, "USUAL_PORT", port)
    usual = Address(port=None)
    with running(FakeSource(), address=usual) as one, running(FakeSource(), address=usual) as two:
        assert one.console.port == port
        assert two.console.port != port
        monkeypatch.setattr(Address, "check", lambda _: None)  # of the certificate
        for address in (Address(port=port), Address("0.0.0.0", port=None)):
            with pytest.raises(CairnError, match=words_in_order(str(port), "in use", "--port")):
                Console(one.hub, address, TOKEN)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "robot.example"])
def test_address_beyond_loopback_needs_a_certificate(host: str) -> None:
    with pytest.raises(CairnError, match=words_in_order(host, "--certificate", "ssh -L")):
        Address(host).check()


def test_page_and_socket_are_served_over_tls_under_any_name(tmp_path: Path) -> None:
    certificate, key = tmp_path / "robot.pem", tmp_path / "robot.key"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    command += [
        "-nodes",
        "-days",
        "2",
        "-subj",
        "/CN=robot",
        "-keyout",
        str(key),
        "-out",
        str(certificate),
    ]
    command += ["-addext", "subjectAltName=DNS:robot.example,IP:127.0.0.1"]
    subprocess.run(command, check=True, capture_output=True)
    key.chmod(0o600)
    trusting = ssl.create_default_context(cafile=certificate)

    with running(FakeSource(), address=Address(certificate=certificate, key=key)) as console:
        url = console.console.websocket_url
        headers = {"Host": "robot.example"}
        answer = HTTPSConnection("127.0.0.1", console.console.port, context=trusting)
        answer.request("GET", "/", headers=headers)
        assert answer.getresponse().status == 200
        answer.close()
        page = Page(connect(url, ssl=trusting, subprotocols=[Subprotocol(CONSOLE)], legacy=True))
        page.text("serverInfo")
        page.close()

    assert url.startswith("wss://127.0.0.1:")


def test_page_that_closes_while_the_console_stops_is_no_error() -> None:
    with running(FakeSource()) as console:
        console.browser().text("serverInfo")

        def close_and_stop() -> None:
            (connection,) = console.console._server.server_state.connections
            connection.data_received(b"\x88\x82\0\0\0\0\x03\xe8")  # a close frame, code 1000
            connection.shutdown()

        console.call(close_and_stop)


def test_token_file_is_created_for_its_owner_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "token"

    token = token_in(path)

    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert token_in(path) == token
    assert len(token) >= 32
    path.chmod(0o644)
    with pytest.raises(CairnError, match="chmod 600"):
        token_in(path)


def test_short_token_in_a_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.touch(0o600)
    path.write_text("secret\n")

    with pytest.raises(CairnError, match=words_in_order("16", "remove the file")):
        token_in(path)

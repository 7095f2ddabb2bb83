"""Endpoints are paths of Unix sockets or network addresses; the default one is the user's own."""

import socket
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.bus.endpoints import (
    default_domain,
    endpoint_for,
    is_loopback,
    listening_domains,
    parse_endpoint,
)


@pytest.mark.parametrize(
    ("text", "endpoint", "loopback"),
    [
        ("/run/cairn/a.sock", "unixsock-stream//run/cairn/a.sock", True),
        ("unixsock-stream//run/cairn/a.sock", "unixsock-stream//run/cairn/a.sock", True),
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447", True),
        ("tcp/localhost:7447", "tcp/localhost:7447", True),
        ("tls/[::1]:7447", "tls/[::1]:7447", True),
        ("tls/robot.example:7447", "tls/robot.example:7447", False),
        ("tcp/0.0.0.0:7447", "tcp/0.0.0.0:7447", False),
    ],
)
def test_paths_and_addresses_are_endpoints(text: str, endpoint: str, loopback: bool) -> None:
    assert parse_endpoint(text) == endpoint
    assert is_loopback(endpoint) is loopback


@pytest.mark.parametrize(
    "text",
    ["", "a.sock", "tcp/127.0.0.1", "tcp/a:0", "tcp/a:70000", "pipe/a:1", "unixsock-stream/a"],
)
def test_other_text_is_rejected(text: str) -> None:
    with pytest.raises(ValueError, match="is not an endpoint; write protocol/host:port"):
        parse_endpoint(text)


@pytest.mark.parametrize("text", ["233", "-1", "one", "0x3"])
def test_invalid_domain_variable_is_rejected(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)

    with pytest.raises(
        CairnError,
        match=f"ROS_DOMAIN_ID='{text}' is not a domain; set it to a number from 0 to 232, or",
    ):
        default_domain()


def test_error_without_a_router_names_the_domains_that_have_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "domain-4.sock").touch()  # of a run that was killed
    with socket.socket(socket.AF_UNIX) as router:
        router.bind(str(tmp_path / "domain-3.sock"))
        router.listen()

        assert listening_domains() == [3]
    assert listening_domains() == []


def test_default_endpoint_is_the_socket_of_the_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", "/run/cairn-7")

    assert endpoint_for("", 3) == "unixsock-stream//run/cairn-7/domain-3.sock"


def test_default_endpoint_in_a_folder_of_others_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.chmod(0o755)
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", str(tmp_path))

    with pytest.raises(CairnError, match="its mode 0755 lets other users in"):
        endpoint_for("", 0)


def test_too_long_a_path_is_rejected() -> None:
    with pytest.raises(ValueError, match="too long for a Unix socket"):
        parse_endpoint("/" + "x" * 107)

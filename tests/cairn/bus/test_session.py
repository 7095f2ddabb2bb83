"""A session restores its lost link to the router as long as the router exists; ids of sessions."""

import os
import socket as sockets
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from typing import Any

import pytest
import zenoh

from cairn import CairnError
from cairn.bus.endpoints import socket_path
from cairn.bus.message_limits import MessageLimits
from cairn.bus.session import is_connected, open_client, open_peer, open_router, process_of
from cairn.bus.zenoh_bus import ZenohBus
from cairn.system.runtime_folder import private_folder
from cairn.testing.launching import new_endpoint, new_socket
from tests.cairn.bus.network import Network, eventually, router_at
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


def test_router_that_comes_back_in_time_counts_as_connected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cairn.bus.session.CONNECT_TIMEOUT_S", LIMIT_S)
    endpoint = new_endpoint()
    router = router_at(endpoint)
    with open_client([endpoint]) as session:
        assert is_connected(session, endpoint)
        router.close()
        assert eventually(lambda: not list(session.info.routers_zid()))

        returned = []
        comes_back = threading.Timer(0.3, lambda: returned.append(router_at(endpoint)))
        comes_back.start()
        try:
            assert is_connected(session, endpoint)
        finally:
            comes_back.join()
            for one in returned:
                one.close()


def test_router_that_stays_away_counts_as_disconnected_unless_its_process_is_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cairn.bus.session.CONNECT_TIMEOUT_S", 0.3)
    endpoint = new_endpoint()
    router = router_at(endpoint)
    with open_client([endpoint]) as session:
        router.close()

        assert eventually(lambda: not list(session.info.routers_zid()))
        assert not is_connected(session, endpoint)

        path = socket_path(endpoint)
        assert path is not None
        path.unlink(missing_ok=True)
        with sockets.socket(sockets.AF_UNIX) as stopped:  # accepts connections, and never answers
            stopped.bind(str(path))
            stopped.listen()
            assert is_connected(session, endpoint)


def test_peers_that_find_each_other_keep_one_link(network: Network) -> None:
    count = 6
    with ThreadPoolExecutor(count) as pool:
        opened = [pool.submit(open_peer, [network.endpoint]) for _ in range(count)]
        peers = [one.result() for one in opened]
    with ExitStack() as stack:
        for peer in peers:
            stack.enter_context(closing(peer))
        assert eventually(lambda: all(len(one.info.peers_zid()) == count - 1 for one in peers))
        links = [len(peer.info.links()) for peer in peers]
    assert links == [count] * count  # the others, and the router


def test_id_of_a_session_names_its_process() -> None:
    with open_router(new_socket()) as session:
        assert process_of(str(session.info.zid())) == f"process {os.getpid()}"


def test_id_of_a_foreign_session_is_named_as_such() -> None:
    assert process_of("4711") == "the foreign session 4711"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user for a moment")
def test_socket_of_another_user_is_named_as_the_cause() -> None:
    socket = new_socket()
    with open_router(socket):
        os.seteuid(65534)
        try:
            with pytest.raises(
                CairnError, match=f"{socket}: user 65534 may not open it.*bus.group"
            ):
                open_client([f"unixsock-stream/{socket}"])
        finally:
            os.seteuid(0)


def test_longer_messages_than_allowed_are_discarded_and_the_link_stays(network: Network) -> None:
    limits = MessageLimits(max_message_size=1 << 16)
    session = open_peer([network.endpoint], new_socket(), limits=limits)
    with closing(ZenohBus(session)) as reader, closing(network.bus()) as writer:
        received: Any = session.declare_subscriber("size", zenoh.handlers.RingChannel(10))
        assert reader.wait_for_peers(LIMIT_S) == []
        for size in (100_000, 10_000_000, 1_000):
            writer.session.put(
                "size", bytes(size), congestion_control=zenoh.CongestionControl.BLOCK
            )

        assert len(received.recv().payload) == 1_000
        assert received.try_recv() is None


def test_sockets_of_killed_peers_are_removed(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = new_socket().with_suffix(".folder")
    monkeypatch.setenv("CAIRN_RUNTIME_DIR", str(folder))
    peers = private_folder(private_folder(folder) / "peers")
    for left in ("999999999-ab.sock", "999999999-ab.sock.lock", f"{os.getppid()}-cd.sock"):
        (peers / left).touch()

    with open_peer([network.endpoint]):
        names = sorted(path.name.partition("-")[0] for path in peers.iterdir())
        assert names == sorted(map(str, [os.getpid(), os.getpid(), os.getppid()]))
    assert [path.name for path in peers.iterdir()] == [f"{os.getppid()}-cd.sock"]

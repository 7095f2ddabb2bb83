"""A process that restarts again and again leaves nothing behind in the others."""

import gc
from collections import Counter

import pytest

from cairn import LATCHED, RELIABLE
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import SECRET, Network, Reader, eventually, node
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes

_RESTARTS = 30
_FEW = 5


def _objects() -> Counter[str]:
    """Return how many objects of each of our classes there are, and of those of Zenoh."""
    gc.collect()
    names = (f"{type(one).__module__}.{type(one).__qualname__}" for one in gc.get_objects())
    return Counter(name for name in names if name.startswith(("cairn.", "zenoh")))


def test_restarts_of_a_peer_leave_no_object_and_no_endpoint_in_the_others(network: Network) -> None:
    own = network.bus()
    reader = Reader(node(own, "/robot/reader"), "/robot/word", String, RELIABLE)
    kept = Reader(node(own, "/robot/keeper"), "/robot/kept", String, LATCHED)
    graph = own.graph

    def restart() -> None:
        # The id of its session is another one each time.
        peer = ZenohBus(open_peer([network.endpoint], secret=SECRET), secret=SECRET)
        writer = node(peer, "/robot/writer")
        word = writer.advertise("/robot/word", String, RELIABLE)
        latched = writer.advertise("/robot/kept", String, LATCHED)
        assert not peer.wait_for_peers(LIMIT_S)
        word.publish(String(data="word"))
        latched.publish(String(data="kept"))
        assert (reader.next().data, kept.next().data) == ("word", "kept")
        assert eventually(lambda: graph.endpoint(word.gid) is not None)
        writer.close()
        peer.close()
        assert eventually(lambda: graph.endpoint(word.gid) is None)
        assert eventually(lambda: graph.endpoint(latched.gid) is None)

    restart()
    before = _objects()
    for _ in range(_RESTARTS):
        restart()

    def left() -> Counter[str]:
        # The subscriptions to the names of its own nodes may have been added meanwhile, once.
        return Counter({name: n for name, n in (_objects() - before).items() if n >= _FEW})

    assert eventually(lambda: not left()), left()

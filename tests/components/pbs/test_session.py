"""The conversation with a PBS-03JN, against the emulated one, on times that the test gives."""

import math

import numpy as np
import pytest

from cairn.components.pbs import messages
from cairn.components.pbs.emulated_pbs import EmulatedPbs, SentDistances
from cairn.components.pbs.frames import FrameSplitter, framed
from cairn.components.pbs.scan_message import ScanShape
from cairn.components.pbs.session import Session
from cairn.schemas.std_msgs import Header


class Talk:
    """A session and a sensor, without a line between them."""

    def __init__(self, sensor: EmulatedPbs, session: Session) -> None:
        self.sensor, self.session = sensor, session
        self.splitter = FrameSplitter()
        self.asked: list[bytes] = []
        self.received: list[list[int]] = []
        self.deaf = False

    def run(self, begin: float, end: float) -> None:
        """Talk, in steps of 10 ms."""
        for now in np.arange(begin, end, 0.01):
            frame = self.session.step(float(now))
            if frame is None:
                continue
            self.asked.append(frame)
            answers = [] if self.deaf else self.sensor.receive(frame, float(now))
            for payload in self.splitter.feed(b"".join(answers)):
                distances = self.session.heard(payload, float(now))
                if distances is not None:
                    self.received.append(distances.tolist())


@pytest.fixture
def sent() -> list[SentDistances]:
    return []


@pytest.fixture
def talk(sent: list[SentDistances]) -> Talk:
    return Talk(EmulatedPbs(on_scan=sent.append), Session(0.1))


def test_it_links_and_gets_every_distance(talk: Talk, sent: list[SentDistances]) -> None:
    talk.run(0.0, 10.0)
    assert talk.received == [one.distances.tolist() for one in sent]
    assert 95 <= len(sent) <= 100
    assert all(one.distances.size == 121 for one in sent)
    assert len({tuple(one) for one in talk.received}) > 90
    # The link is renewed every two seconds, and holds for three.
    assert talk.session.missed == 0
    assert sum(frame.startswith(b"\x02H%H") for frame in talk.asked) == 5


def test_the_sensor_tells_nothing_to_one_without_a_link() -> None:
    sensor = EmulatedPbs(code=bytes(8))
    ask, link = framed(messages.DISTANCES), framed(messages.link_request(bytes(8)))
    assert sensor.receive(ask, 0.0) == []
    assert sensor.receive(framed(messages.link_request(b"another.")), 0.0) == [
        framed(messages.LINK + b"\x00")
    ]
    assert sensor.receive(ask, 0.0) == []
    assert sensor.receive(link, 1.0) == [framed(messages.LINK + b"\x01")]
    assert len(sensor.receive(ask, 3.9)) == 1
    assert sensor.receive(ask, 4.1) == []
    sensor.receive(link, 5.0)
    assert sensor.receive(framed(messages.link_request(bytes(8), on=False)), 5.1) == [
        framed(messages.LINK + b"\x00")
    ]
    assert sensor.receive(ask, 5.2) == []


def test_a_silent_sensor_is_given_up_and_one_that_comes_back_is_not(talk: Talk) -> None:
    talk.run(0.0, 1.0)
    talk.deaf = True
    talk.run(1.0, 2.0)
    assert not talk.session.silent
    talk.deaf = False
    talk.run(2.0, 4.0)
    assert not talk.session.silent
    talk.received.clear()
    talk.run(4.0, 5.0)
    assert len(talk.received) >= 9
    talk.deaf = True
    talk.run(5.0, 8.0)
    assert talk.session.silent


def test_a_sensor_that_was_switched_off_meanwhile_has_another_code(talk: Talk) -> None:
    talk.run(0.0, 1.0)
    talk.sensor.powered_on(1.0)
    talk.run(1.0, 4.0)
    talk.received.clear()
    talk.run(4.0, 5.0)
    assert len(talk.received) >= 9


def test_distances_in_place_of_the_links_confirmation_are_good(talk: Talk) -> None:
    talk.run(0.0, 1.0)
    found = talk.session.heard(messages.DISTANCES + bytes(242), 1.0)
    assert found is not None
    assert found.size == 121


def test_the_link_is_ended_once(talk: Talk) -> None:
    assert talk.session.farewell() is None
    talk.run(0.0, 1.0)
    farewell = talk.session.farewell()
    assert farewell is not None
    assert talk.sensor.receive(farewell, 1.0) == [framed(messages.LINK + b"\x00")]
    assert talk.session.farewell() is None


def test_ranges_are_those_of_rep_117() -> None:
    distances = np.full(121, 1500, np.int32)
    distances[:4] = 0, 150, 3001, 0xFFFF
    scan = ScanShape(math.radians(1.8), 3.0).scan(distances, Header())
    assert math.isnan(scan.ranges[0])
    assert scan.ranges[1:5].tolist() == [-math.inf, math.inf, math.inf, 1.5]
    assert scan.angle_min == pytest.approx(-math.radians(108.0))
    assert scan.angle_max == pytest.approx(math.radians(108.0))
    assert (scan.range_min, scan.range_max) == pytest.approx((0.2, 3.0))

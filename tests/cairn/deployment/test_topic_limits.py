"""What the transport accepts on a topic follows from the inputs that read it."""

import pytest

from cairn import CairnError, Component, In, on
from cairn.bus.message_limits import MAX_MESSAGE_SIZE, TRANSPORT_FACTOR
from cairn.deployment.model import Deployment
from cairn.deployment.topic_limits import topic_limits
from cairn.schemas.geometry_msgs import Vector3
from cairn.schemas.sensor_msgs import Image, LaserScan
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import DeploymentHarness
from tests.wording import assert_words


class Near(Component):
    scan: In[LaserScan] = In(optional=True, max_bytes=20_000)
    speed: In[Vector3] = In(optional=True)


class Far(Component):
    scan: In[LaserScan] = In(optional=True, max_bytes=30_000)
    image: In[Image] = In(optional=True)


class Panorama(Component):
    image: In[Image] = In(optional=True, max_bytes=100 << 20)


class Reader(Component):
    words: In[String] = In(optional=True, max_bytes=100)

    @on("words")
    def read(self, word: String) -> None:
        self.last = word.data


def deployment(*classes: type[Component], **bus: int) -> Deployment:
    components = {
        cls.__name__.lower(): {
            "plugin": f"{__name__}:{cls.__name__}", "topics": {"scan": "/front/scan"}
            if "scan" in cls.__annotations__ else {},
        }
        for cls in classes
    }  # fmt: skip
    page = {"cairn": 1, "robot": "rover", "bus": bus, "components": components}
    return Deployment.model_validate(page)


def test_topic_accepts_what_its_most_generous_input_does() -> None:
    limits = topic_limits(deployment(Near, Far))

    assert limits.topics["/front/scan"] == TRANSPORT_FACTOR * 30_000
    assert limits.topics["/rover/speed"] == TRANSPORT_FACTOR * 4096
    assert "/rover/image" not in limits.topics  # as long as the bus accepts
    assert limits.max_message_size == MAX_MESSAGE_SIZE


def test_bus_accepts_the_longest_message_of_its_inputs_unless_the_deployment_forbids() -> None:
    assert topic_limits(deployment(Near, Panorama)).max_message_size == 100 << 20
    assert (
        topic_limits(deployment(Near, Panorama, max_message_size=65_536)).max_message_size == 65_536
    )


def test_limit_of_a_port_holds_in_lockstep_and_is_reported_by_status_and_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with DeploymentHarness(deployment(Reader)) as robot:
        robot.publish("words", *(String(data=text) for text in ("short", "x" * 1_000, "end")))

        (port,) = robot.run.runtime("reader").status().ports
    assert (port.messages, port.invalid, port.dropped) == (2, 1, 0)
    (problem,) = [one.getMessage() for one in caplog.records if "1,009" in one.getMessage()]
    assert_words(problem, "/rover/words", "/rover/test", "100", "max_bytes")


@pytest.mark.parametrize("limit", [0, -1, (1 << 30) + 1])
def test_impossible_limit_of_a_port_is_an_error(limit: int) -> None:
    with pytest.raises(CairnError, match=f"max_bytes={limit}"):
        In(max_bytes=limit)

"""The base behind ROS 2 fulfills the base contract, with an independent ROS 2 node as the base."""

from collections.abc import Iterator

import pytest

from cairn import SENSOR
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.components.ros2_devices.base import Ros2Base
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.testing.base_contract import BaseContract, SafetyContract
from cairn.testing.driver_contract import Contract
from cairn.testing.robot import Arrival, Reading, RunningDeployment
from cairn.testing.timing import undisturbed
from tests.cairn.bus.network import eventually, node
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.components.base_life import BaseLifeContract
from tests.components.ros2_devices.foreign_base import ForeignBase, foreign_base
from tests.patience import LIMIT_S

DEPLOYMENT = """
    external_topics: [/odom, cmd_vel]
    components:
      base:
        plugin: ros2_base
        topics: {base_odom: /odom, base_cmd_vel: /cmd_vel}
        parameters: {base_frame: base_footprint, odom_rate: 20}
    """


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForeignBase]:
    with foreign_base(tmp_path_factory.mktemp("definitions")) as base:
        yield base


class BaseBehindRos2(Contract):
    """The base of both contracts."""

    deployment = DEPLOYMENT
    component, port, message = "base", "odom", Odometry
    rate_hz = 20.0

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, base: ForeignBase) -> ForeignBase:
        return base


@pytest.mark.accuracy
class TestRos2Life(BaseBehindRos2, BaseLifeContract):
    """The base without tests in real time."""


@pytest.mark.accuracy
@pytest.mark.realtime
class TestRos2Base(BaseBehindRos2, SafetyContract):
    top_speed = 0.6
    return_limit_s = LIMIT_S

    def test_driver_and_base_continue_without_their_router(
        self, robot: RunningDeployment, output: Reading[Odometry], device: ForeignBase
    ) -> None:
        def drive_without_router() -> list[Arrival[Odometry]]:
            with robot.publishing(self.topic(robot, "cmd_vel"), self.ahead()):
                before = output.count
                output.await_that(
                    lambda odoms: any(map(_moves, odoms)), "a moving base", after=before
                )
                device.stop_router()
                try:
                    return output.await_count(20, after=output.count)
                finally:
                    device.start_router()

        later = undisturbed(drive_without_router)
        assert all(map(_moves, later)), "the base stopped"
        assert device.await_stand(LIMIT_S)


def _moves(odom: Arrival[Odometry]) -> bool:
    return odom.message.twist.twist.linear.x > 0.1


@pytest.mark.realtime
def test_stamped_commands_drive_a_recent_controller(base: ForeignBase) -> None:
    bus, driver_bus = ZenohBus(open_peer([base.router])), ZenohBus(open_peer([base.router]))
    try:
        commander = node(bus, "/robot/commander").advertise("/robot/cmd_vel", Twist, SENSOR)
        driver = ThreadedComponent(
            Ros2Base,
            driver_bus,
            name="base",
            topics={"base_odom": "/odom", "base_cmd_vel_stamped": "/stamped/cmd_vel"},
            parameters={"base_frame": "base_footprint", "stamped": True},
        )
        driver.activate()

        def driven() -> bool:
            commander.publish(Twist(linear=Vector3(x=0.2)))
            return base.turns()

        try:
            assert eventually(driven), "the base does not move"
            driver.request("deactivate")
            assert base.await_stand(LIMIT_S)
        finally:
            driver.close()
    finally:
        bus.close()
        driver_bus.close()


def test_both_classes_together_run_the_whole_contract() -> None:
    run = {name for one in (TestRos2Life, TestRos2Base) for name in dir(one)}

    assert {name for name in dir(BaseContract) if name.startswith("test_")} <= run

"""The simulated drivers fulfill the contracts of messages and life cycle, all in one deployment.

Messages are judged in real time, so these tests must not run beside those that compute much.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from cairn.schemas.cairn_sim_msgs import WorldState
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import CameraInfo, LaserScan
from cairn.testing.base_contract import SafetyContract
from cairn.testing.camera_contract import PicturesContract
from cairn.testing.driver_contract import LifeCycleContract, ParametersContract, StopContract
from cairn.testing.robot import Arrival, Bench, Reading, RunningDeployment, settings
from cairn.testing.scanner_contract import ScanContract

WORLD = Path(__file__).parents[3] / "deploy" / "worlds" / "room.yaml"
DEPLOYMENT = """
    settings: {world: ""}
    external_topics: [cmd_vel]
    components:
      world:
        plugin: simulated_world
        parameters: {world: "${world}", radius: 0.2}
      base: {plugin: simulated_base}
      scanner:
        plugin: simulated_scanner
        parameters: {model: UST-10LX, rate: 20, skip: 3}
      camera:
        plugin: simulated_stereo_camera
        parameters: {width: 80, height: 60, rate: 10}
    """


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    words = settings({"world": str(WORLD)})
    with Bench(tmp_path_factory.mktemp("simulated"), DEPLOYMENT, words) as bench:
        yield bench


@pytest.mark.realtime
class TestScans(ScanContract):
    rate_hz = 20.0
    # It stands in a corner of the room, a meter from the wall on its right.
    surroundings = {math.radians(-90.0): 1.0}


@pytest.mark.realtime
class TestPictures(PicturesContract):
    rate_hz = 10.0


class TrueWheels:
    """The wheels of the simulated base, as its world knows them; a device of the contracts.

    The world publishes true speeds with each state, also while no wheel turns.
    """

    def __init__(self, states: Reading[WorldState]) -> None:
        self._states = states

    def turns(self) -> bool:
        before = self._states.count
        return not _stands(self._states.await_count(1, after=before)[0])

    def await_stand(self, limit_s: float) -> bool:
        try:
            self._states.await_that(
                lambda arrivals: any(map(_stands, arrivals)),
                "wheels that stand",
                after=self._states.count,
                limit_s=limit_s,
            )
        except AssertionError:
            return False
        return True


def _stands(state: Arrival[WorldState]) -> bool:
    return math.hypot(state.message.forward, state.message.turn) < 0.001


@pytest.mark.realtime
class TestDrive(SafetyContract):
    rate_hz = 50.0
    top_speed = 0.6

    @pytest.fixture
    def device(self, robot: RunningDeployment) -> Iterator[TrueWheels]:
        with robot.read("world_state", WorldState) as states:
            yield TrueWheels(states)


class Life(StopContract, LifeCycleContract, ParametersContract):
    return_limit_s = 30.0  # these run beside other tests
    cycles = 6


@pytest.mark.accuracy
class TestScannersLife(Life):
    component, port, message, rate_hz = "scanner", "scan", LaserScan, 20.0


@pytest.mark.accuracy
class TestCamerasLife(Life):
    component, port, message, rate_hz = "camera", "left_info", CameraInfo, 10.0
    live_parameters = {"sensor.gain": 2.0}


class TestBasesLife(Life):
    component, port, message, rate_hz = "base", "odom", Odometry, 50.0

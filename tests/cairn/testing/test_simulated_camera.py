"""The simulated stereo camera keeps the contract of a camera."""

from cairn.testing.camera_contract import StereoCameraContract

DEPLOYMENT = """
    settings: {world: ""}
    external_topics: [cmd_vel]
    components:
      world:
        plugin: simulated_world
        parameters: {world: "${world}", radius: 0.2}
      base: {plugin: simulated_base}
      camera:
        plugin: simulated_stereo_camera
        parameters: {width: 160, height: 120, rate: 10}
    """


class TestSimulatedCamera(StereoCameraContract):
    deployment = DEPLOYMENT
    sets = ["world=deploy/worlds/room.yaml"]
    rate_hz = 10.0
    live_parameters = {"sensor.gain": 2.0}

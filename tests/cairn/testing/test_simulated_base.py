"""The simulated base keeps the contract of a base."""

from cairn.testing.base_contract import BaseContract

DEPLOYMENT = """
    settings: {world: ""}
    external_topics: [cmd_vel]
    components:
      world:
        plugin: simulated_world
        parameters: {world: "${world}", radius: 0.2}
      base: {plugin: simulated_base}
    """


class TestSimulatedBase(BaseContract):
    deployment = DEPLOYMENT
    sets = ["world=deploy/worlds/room.yaml"]
    rate_hz = 50.0
    top_speed = 0.6

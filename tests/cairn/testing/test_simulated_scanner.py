"""The simulated scanner keeps the contract of a range scanner."""

from cairn.testing.scanner_contract import RangeScannerContract

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
    """


class TestSimulatedScanner(RangeScannerContract):
    deployment = DEPLOYMENT
    sets = ["world=deploy/worlds/room.yaml"]
    rate_hz = 20.0

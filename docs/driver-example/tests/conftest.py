"""The fixtures of the conformance kit: launch, deploy, bench, device."""

pytest_plugins = ["cairn.testing.plugin"]

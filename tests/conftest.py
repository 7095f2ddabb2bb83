"""What all tests may use: the project's own conformance kit, as users have it."""

pytest_plugins = ["cairn.testing.plugin"]

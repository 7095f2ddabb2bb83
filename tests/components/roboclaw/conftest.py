"""The kit's fixtures, but for `launch`, which all tests have."""

from cairn.testing.plugin import bench, deploy, device

__all__ = ["bench", "deploy", "device"]

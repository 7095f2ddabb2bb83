"""Roles of users on the network; what each may do is in `cairn.deployment.access_control`."""

from typing import Literal

Role = Literal["view", "operate", "administer"]
"""What a user on the network may do; each role includes those before it."""

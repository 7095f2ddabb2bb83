"""Zenoh's TLS links, with the certificates as Cairn makes them and an ACL of the roster's names."""

import dataclasses
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from cairn import CairnError
from cairn.bus.control import ControlError
from cairn.bus.credentials import Credentials
from cairn.bus.session import open_client
from cairn.security.authority import Authority
from cairn.security.identity import Identity, own_identity
from tests.cairn.bus.test_gateway import Robot, request
from tests.cairn.security.computers import days_ago, new_authority
from tests.cairn.security.test_tls import self_signed

pytestmark = pytest.mark.processes


def bus_of(authority: Authority) -> dict[str, Any]:
    """Return the section `bus` of a deployment that admits the operators in force."""
    own, roster = own_identity(authority.folder, "base"), authority.roster()
    roles = {
        name: role
        for role in ("view", "operate", "administer")
        for name in roster.common_names("operator", role)
    }
    return {
        "tls": {
            "certificate": str(own.certificate),
            "key": str(own.key),
            "ca": str(own.ca),
            "client_certificates": True,
            "certificate_roles": roles,
        }
    }


@contextmanager
def session(robot: Robot, ca: Path, identity: Identity) -> Iterator[zenoh.Session]:
    presented = Credentials(
        ca=str(ca), certificate=str(identity.certificate), key=str(identity.key)
    )
    opened = open_client([robot.endpoint], presented)
    try:
        yield opened
    finally:
        opened.close()


def test_operators_in_force_connect_and_all_others_do_not(tmp_path: Path) -> None:
    with days_ago(10):
        authority = new_authority(tmp_path / "authority", days=1)
    folder = authority.folder
    expired = tmp_path / "expired.pem", tmp_path / "expired.key"
    for path, source in zip(
        expired, (folder.certificate("alice"), folder.key("alice")), strict=True
    ):
        path.touch(0o600)
        path.write_bytes(source.read_bytes())
    for name in ("base", "alice", "wall"):
        authority.renew(name)
    alice, wall = (own_identity(folder, name) for name in ("alice", "wall"))
    stranger = own_identity(new_authority(tmp_path / "other").folder, "alice")
    (tmp_path / "bus").mkdir()

    with closing(Robot(tmp_path / "bus", bus_of(authority), "tls")) as robot:
        with session(robot, folder.ca, alice) as operator:
            assert request(operator, "renew_lease") == "renew_lease"
            with pytest.raises(ControlError, match="no reply to deactivate"):
                request(operator, "deactivate")
        with session(robot, folder.ca, wall) as viewer:
            assert request(viewer, "parameters") == "parameters"
            with pytest.raises(ControlError, match="no reply to renew_lease"):
                request(viewer, "renew_lease")
        for wrong in (
            stranger,
            self_signed(alice, tmp_path),
            dataclasses.replace(alice, certificate=expired[0], key=expired[1]),
        ):
            with (
                pytest.raises(CairnError, match="no router answers"),
                session(robot, folder.ca, wrong),
            ):
                pass
        with pytest.raises(CairnError, match="no router"), session(robot, stranger.ca, alice):
            pass  # the client trusts another authority only, so it refuses the robot

    posing = bus_of(authority)
    posing["tls"] |= {"certificate": str(alice.certificate), "key": str(alice.key)}
    with (
        closing(Robot(tmp_path / "bus", posing, "tls")) as robot,
        pytest.raises(CairnError, match="no router"),
        session(robot, folder.ca, wall),
    ):
        pass  # an operator's certificate does not make a robot

    kept = tmp_path / "revoked.pem", tmp_path / "revoked.key"
    kept[0].write_bytes(alice.certificate.read_bytes())
    kept[1].touch(0o600)
    kept[1].write_bytes(alice.key.read_bytes())
    authority.revoke("alice")
    revoked = dataclasses.replace(alice, certificate=kept[0], key=kept[1])
    with (
        closing(Robot(tmp_path / "bus", bus_of(authority), "tls")) as robot,
        session(robot, folder.ca, revoked) as operator,
        pytest.raises(ControlError, match="no reply to parameters"),
    ):
        request(operator, "parameters")

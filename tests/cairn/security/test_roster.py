"""A roster counts only as the authority has signed it, for this robot, and not an older one."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cairn import CairnError
from cairn.security.authority import Authority
from cairn.security.folder import RobotFolder
from cairn.security.roster import Roster, accept_roster, parse_roster, read_roster, sign_roster
from tests.cairn.security.computers import ROBOT, computer, new_authority
from tests.wording import words_in_order

SHARED = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """A signed roster, and the certificate of its authority."""
    authority = new_authority(tmp_path_factory.mktemp("authority"))
    authority.renew("brain")
    authority.revoke("alice")
    return authority.roster_file(), authority.ca_pem


def member(authority: Authority, home: Path) -> RobotFolder:
    """Return the folder of a computer that has the authority's roster."""
    with computer(home) as folder:
        folder.create()
        folder.ca.touch(0o600)
        folder.ca.write_bytes(authority.ca_pem)
        accept_roster(folder, authority.roster_file())
    return folder


@given(data=st.data())
@SHARED
def test_roster_with_a_changed_byte_is_refused(
    signed: tuple[bytes, bytes], data: st.DataObject
) -> None:
    content, ca = signed
    place = data.draw(st.integers(0, len(content) - 1))
    changed = bytearray(content)
    changed[place] ^= data.draw(st.integers(1, 255))

    with pytest.raises(CairnError, match=r"^received"):
        parse_roster(bytes(changed), ca, ROBOT, "received")


@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)))
@SHARED
def test_other_content_is_refused(signed: tuple[bytes, bytes], content: bytes) -> None:
    for text in (content, signed[0] + content + b" ", signed[0][: len(content)]):
        with pytest.raises(CairnError, match=r"^received"):
            parse_roster(text, signed[1], ROBOT, "received")


def test_valid_roster_is_read_as_signed(signed: tuple[bytes, bytes]) -> None:
    roster = parse_roster(*signed, ROBOT, "received")

    assert {one.name for one in roster.in_force()} == {"base", "brain", "wall"}
    assert len(roster.common_names("machine")) == 3  # the renewed one twice
    assert roster.common_names(role="operate") == ()


def test_roster_of_another_authority_or_robot_is_refused(
    authority: Authority, tmp_path: Path
) -> None:
    other = new_authority(tmp_path / "other")
    with pytest.raises(CairnError, match="has not signed"):
        parse_roster(other.roster_file(), authority.ca_pem, ROBOT, "received")
    with pytest.raises(CairnError, match=words_in_order("of robot rover", "not of digger")):
        parse_roster(authority.roster_file(), authority.ca_pem, "digger", "received")


def test_older_roster_is_refused_and_the_newer_one_remains(
    authority: Authority, tmp_path: Path
) -> None:
    before = authority.roster_file()
    authority.revoke("brain")
    folder = member(authority, tmp_path / "base")

    with pytest.raises(CairnError, match=words_in_order("version 1", "version 2", "backup")):
        accept_roster(folder, before)

    assert "brain" not in {one.name for one in read_roster(folder).in_force()}
    assert accept_roster(folder, authority.roster_file()) == authority.roster()


def test_restored_authority_continues_from_the_newest_roster(
    authority: Authority, tmp_path: Path
) -> None:
    backup = authority.roster_file()
    authority.revoke("brain")
    folder = member(authority, tmp_path / "base")
    authority.folder.roster.write_bytes(backup)  # restored: it knows of no revocation

    authority.folder.roster.write_bytes(folder.roster.read_bytes())
    authority.revoke("alice")

    known = accept_roster(folder, authority.roster_file())
    assert {one.name for one in known.in_force()} == {"base", "wall"}


def test_different_roster_with_the_same_version_is_refused(
    authority: Authority, tmp_path: Path
) -> None:
    folder = member(authority, tmp_path / "base")
    known = authority.roster()
    other = Roster(robot=ROBOT, version=known.version, issued=known.issued, entries=())

    with pytest.raises(CairnError, match="not newer"):
        accept_roster(folder, sign_roster(other, authority._key))


def test_more_than_a_roster_may_have_is_refused(signed: tuple[bytes, bytes]) -> None:
    with pytest.raises(CairnError, match="more than a roster may have"):
        parse_roster(signed[0] + b" " * (1 << 20), signed[1], ROBOT, "received")

"""The authority issues, renews and revokes certificates; its files are for its user alone."""

import base64
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from cairn import CairnError
from cairn.security import certificates
from cairn.security.authority import Authority, AuthorityMember, check_addresses, members_of
from cairn.security.bundle import export_identity, import_identity
from cairn.security.folder import RobotFolder
from cairn.security.identity import own_identity
from tests.cairn.security.computers import computer, days_ago, new_authority
from tests.wording import words_in_order


def test_only_their_owner_may_read_the_files(authority: Authority) -> None:
    root = authority.folder.path.parent

    found = {path: stat.S_IMODE(path.stat().st_mode) for path in (root, *root.rglob("*"))}

    assert {mode for path, mode in found.items() if path.is_dir()} == {0o700}
    assert {mode for path, mode in found.items() if path.is_file()} == {0o600}


def test_existing_authority_is_not_replaced(authority: Authority, tmp_path: Path) -> None:
    with pytest.raises(CairnError, match=words_in_order("ca.pem", "already", "security add")):
        new_authority(tmp_path / "authority")

    assert own_identity(authority.folder, "base").entry.name == "base"


@pytest.mark.parametrize("part", ["", "rover", "rover/identities"])
def test_folder_that_others_may_open_is_refused(authority: Authority, part: str) -> None:
    (authority.folder.path.parent / part).chmod(0o755)

    with pytest.raises(CairnError, match=words_in_order("0755", "chmod 700", "CAIRN_SECURITY_DIR")):
        authority.roster()


@pytest.mark.parametrize("name", ["ca.key", "ca.pem", "roster.json", "identities/base.key"])
def test_file_that_others_may_change_is_refused(authority: Authority, name: str) -> None:
    path = authority.folder.path / name
    path.chmod(0o666)

    with pytest.raises(CairnError, match=words_in_order(str(path), "0666", "chmod 600")):
        own_identity(Authority(authority.folder).folder, "base")


def test_authority_with_the_key_of_another_is_refused(authority: Authority, tmp_path: Path) -> None:
    other = new_authority(tmp_path / "other")
    authority.folder.ca_key.write_bytes(other.folder.ca_key.read_bytes())

    with pytest.raises(CairnError, match=words_in_order("not the key of", "ca.pem")):
        Authority(authority.folder)


def test_name_that_is_issued_again_has_another_common_name(authority: Authority) -> None:
    lost = own_identity(authority.folder, "brain").entry
    authority.revoke("brain")
    assert lost.common_name not in authority.roster().common_names()
    with pytest.raises(CairnError, match="no such file"):
        own_identity(authority.folder, "brain")

    again = authority.add(AuthorityMember("brain", addresses=("192.168.1.11",)))

    assert again.common_name != lost.common_name
    assert authority.roster().common_names("machine") == tuple(
        sorted([again.common_name, own_identity(authority.folder, "base").entry.common_name])
    )


def test_renewed_certificate_replaces_the_earlier_one_after_a_while(authority: Authority) -> None:
    earlier = own_identity(authority.folder, "alice")
    earlier_key = earlier.key.read_bytes()

    renewed = authority.renew("alice", grace_s=60)

    both = {earlier.entry.common_name, renewed.common_name}
    now = time.time()
    assert set(authority.roster().common_names(role="operate", at=now)) == both
    assert authority.roster().common_names(role="operate", at=now + 61) == (renewed.common_name,)
    assert own_identity(authority.folder, "alice").entry == renewed
    assert earlier.key.read_bytes() != earlier_key


def test_interrupted_replacement_of_an_identity_is_completed(authority: Authority) -> None:
    folder = authority.folder
    before = own_identity(folder, "brain")
    old = before.certificate.read_bytes(), before.key.read_bytes()
    authority.renew("brain")
    new = before.certificate.read_bytes() + before.key.read_bytes()
    # Killed between the two files: the key is the new one, the certificate is not.
    following = folder.identities / "brain.next"
    following.touch(0o600)
    following.write_bytes(new)
    before.certificate.write_bytes(old[0])

    assert own_identity(folder, "brain").entry != before.entry
    assert not following.exists()
    before.certificate.write_bytes(old[0])
    with pytest.raises(CairnError, match="private key beside it is not of this certificate"):
        own_identity(folder, "brain")


def test_damaged_certificate_is_refused_when_it_is_read(authority: Authority) -> None:
    made = certificates.read_certificate(authority.ca_pem, "ca.pem")
    der = made.public_bytes(Encoding.DER)
    damages = {
        "version": (b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x07"),
        "name": (b"\x06\x03\x55\x04\x03\x0c", b"\x06\x03\x55\x04\x03\x1e"),
        "extension": (b"\x30\x06\x01\x01\xff\x02\x01\x00", b"\x30\x06\x01\x01\xff\x02\x07\x00"),
    }
    for part, (right, wrong) in damages.items():
        assert right in der, part
        damaged = base64.encodebytes(der.replace(right, wrong))
        pem = b"-----BEGIN CERTIFICATE-----\n%b-----END CERTIFICATE-----\n" % damaged
        with pytest.raises(CairnError, match=r"ca\.pem: it is not a certificate"):
            certificates.read_certificate(pem, "ca.pem")


def test_expired_identity_is_refused_with_the_remedy(tmp_path: Path) -> None:
    with days_ago(10):
        authority = new_authority(tmp_path, days=1)

    with pytest.raises(CairnError, match=words_in_order("brain", "expired on", "security token")):
        own_identity(authority.folder, "brain")
    assert authority.roster().common_names() == ()
    authority.renew("brain")
    assert own_identity(authority.folder, "brain").entry.name == "brain"


def test_clock_before_the_certificates_is_reported(tmp_path: Path) -> None:
    authority = new_authority(tmp_path)

    with days_ago(1), pytest.raises(CairnError, match="clock of this computer"):
        own_identity(authority.folder, "brain")


def test_certificates_end_with_their_authority(tmp_path: Path) -> None:
    with computer(tmp_path) as folder, days_ago(10):
        authority = Authority.create(folder, members_of({"base": ("::1",)}, {}), 90, 15)
    ca_end = certificates.not_after(authority.ca)

    assert authority.roster().entries[0].not_after == ca_end
    with days_ago(-10), pytest.raises(CairnError, match="authority: it expired"):
        authority.renew("base")


@pytest.mark.parametrize(
    "address",
    ["", "192.168.1.300", "0.0.0.0", "::", "a b", "robot:7447", "-x", "*.local", "a..b",
     "fe80::1%eth0", "\u212a.local"],
)  # fmt: skip
def test_wrong_addresses_are_refused(address: str) -> None:
    with pytest.raises(CairnError, match="machine brain"):
        check_addresses("brain", [address])


def test_names_are_checked() -> None:
    for machines, reason in (
        ({"../brain": ("::1",)}, "valid name"),
        ({"Brain": ("::1",)}, "valid name"),
        ({"alice": ("::1",)}, "machine and an operator"),
    ):
        with pytest.raises(CairnError, match=reason):
            members_of(machines, {"alice": "view"})
    with pytest.raises(CairnError, match=words_in_order("robot '../rover'", "valid name")):
        RobotFolder.of("../rover")


def test_names_too_long_for_a_certificate_are_refused(authority: Authority) -> None:
    with pytest.raises(CairnError, match=words_in_order("together 47 characters, and may have 45")):
        authority.add(AuthorityMember("x" * 42, "view"))


def test_exported_identity_is_imported_elsewhere(authority: Authority, tmp_path: Path) -> None:
    file = tmp_path / "brain.identity"
    export_identity(authority.folder, "brain", file)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    with pytest.raises(CairnError, match=str(file)):
        export_identity(authority.folder, "base", file)

    with computer(tmp_path / "brain") as folder:
        imported = import_identity(file)
        assert imported == own_identity(folder, "brain")
        assert not folder.ca_key.exists()
        with pytest.raises(CairnError, match="where `cairn security init` was run"):
            Authority(folder)


def test_changed_or_revoked_exported_identity_is_refused(
    authority: Authority, tmp_path: Path
) -> None:
    file, revoked = tmp_path / "brain.identity", tmp_path / "base.identity"
    export_identity(authority.folder, "base", revoked)
    authority.revoke("base")
    export_identity(authority.folder, "brain", file)
    text = file.read_text()
    for old, new in (('"rover"', '"other"'), ('"brain"', '"alice"'), ("version", "Version")):
        file.write_text(text.replace(old, new, 1))
        with computer(tmp_path / "changed"), pytest.raises(CairnError):
            import_identity(file)
    file.write_text(text)

    with computer(tmp_path / "brain"):
        import_identity(file)
        with pytest.raises(CairnError, match="base was revoked"):
            import_identity(revoked)
        file.chmod(0o644)
        with pytest.raises(CairnError, match="chmod 600"):
            import_identity(file)


def test_reading_the_models_does_not_import_the_library_for_certificates() -> None:
    program = "import cairn.security.roster, sys; sys.exit('cryptography' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

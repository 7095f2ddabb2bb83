"""Enrollment with a token; roster and renewal for those whose identity is in force."""

import base64
import http.client
import json
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn import CairnError
from cairn.security import certificates, service
from cairn.security.authority import Authority
from cairn.security.enrollment import (
    AuthorityRefused,
    AuthorityUnreachable,
    enroll,
    fetch_roster,
    read_url,
    renew_own,
)
from cairn.security.identity import own_identity
from cairn.security.roster import read_roster
from cairn.security.service import AuthorityService, WrongAttempts
from cairn.security.tokens import Token, decode_token
from tests.cairn.security.computers import (
    ROBOT,
    client_context,
    computer,
    days_ago,
    new_authority,
    serving,
    token_for,
)
from tests.patience import LIMIT_S
from tests.wording import words_in_order


@pytest.fixture
def running(authority: Authority) -> Iterator[AuthorityService]:
    with serving(authority) as running:
        yield running


def request_for(name: str) -> str:
    """Return a request for a certificate (PEM)."""
    return certificates.new_request(certificates.new_key(), name).decode()


def post(
    running: AuthorityService, path: str, body: Any, ca: Path, **headers: str
) -> tuple[int, str]:
    """Send a request without a certificate; return status and text of the answer."""
    address = running.url.removeprefix("https://")
    connection = http.client.HTTPSConnection(address, timeout=LIMIT_S, context=client_context(ca))
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    connection.request("POST", path, data, {"Content-Type": "application/json", **headers})
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_computer_enrolls_with_a_key_that_it_makes(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    before = own_identity(authority.folder, "brain").entry
    token = token_for(authority, running, "brain")

    with computer(tmp_path / "brain") as folder:
        identity = enroll(token.encode())
        assert own_identity(folder, "brain") == identity
        assert read_url(folder, "") == running.url

    assert identity.entry.common_name in authority.roster().common_names("machine")
    assert before.common_name not in authority.roster().common_names()
    assert not authority.folder.key("brain").exists()
    assert token.secret not in authority.folder.tokens.read_text()


def test_token_is_used_once_also_at_the_same_time(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    token = token_for(authority, running, "brain")
    body = {
        "name": "brain",
        "secret": token.secret,
        "request": certificates.new_request(certificates.new_key(), "brain").decode(),
    }
    answers: list[int] = []

    def send() -> None:
        answers.append(post(running, "/enroll", body, authority.folder.ca)[0])

    threads = [threading.Thread(target=send) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT_S)

    assert sorted(answers) == [200, 403, 403, 403]


def test_token_that_was_lost_counts_no_more_once_another_one_was_used(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    lost, other = (token_for(authority, running, name) for name in ("brain", "base"))
    with computer(tmp_path / "brain"):
        enroll(token_for(authority, running, "brain").encode())
    with computer(tmp_path / "thief"), pytest.raises(AuthorityRefused, match="used already"):
        enroll(lost.encode())
    with computer(tmp_path / "base"):
        enroll(other.encode())


def changed(token: Token, **values: str) -> str:
    return token.model_copy(update=values).encode()


WRONG: dict[str, Callable[[Token], str]] = {
    "of another name": lambda token: changed(token, name="base"),
    "of an unknown name": lambda token: changed(token, name="nothing"),
    "with a wrong secret": lambda token: changed(token, secret="0" * 64),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_token_is_refused(
    authority: Authority, running: AuthorityService, tmp_path: Path, what: str
) -> None:
    token = token_for(authority, running, "brain")
    version = authority.roster().version

    with computer(tmp_path / "brain") as folder, pytest.raises(CairnError, match="token is wrong"):
        enroll(WRONG[what](token))

    assert authority.roster().version == version
    assert not folder.ca.exists()


def test_expired_token_and_token_of_a_revoked_identity_are_refused(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    revoked = token_for(authority, running, "alice")
    authority.revoke("alice")
    expired = token_for(authority, running, "brain", valid_s=-1)  # last: a new one removes it

    with computer(tmp_path / "new"):
        for token in (expired, revoked):
            with pytest.raises(CairnError, match=words_in_order("expired", "make a new one")):
                enroll(token.encode())


def test_nothing_secret_is_sent_to_another_authority(authority: Authority, tmp_path: Path) -> None:
    other = new_authority(tmp_path / "other")
    lines: list[str] = []
    with serving(other, lines) as impostor, computer(tmp_path / "brain") as folder:
        token = token_for(authority, impostor, "brain")
        with pytest.raises(CairnError, match=words_in_order("not the authority", "Nothing was")):
            enroll(token.encode())
        assert not folder.ca.exists()
    assert lines == []  # neither enrolled nor refused: no request with a token came


def test_service_at_another_address_than_its_certificate_has_is_refused(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    token = token_for(authority, running, "brain")
    elsewhere = token.url.replace("127.0.0.1", "localhost")

    with computer(tmp_path / "brain"), pytest.raises(CairnError, match="does not prove"):
        enroll(changed(token, url=elsewhere))


def test_computer_that_knows_another_authority_keeps_it(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    other = new_authority(tmp_path / "other")
    with computer(tmp_path / "other"), pytest.raises(CairnError, match="knows another authority"):
        enroll(token_for(authority, running, "brain").encode())

    assert own_identity(other.folder, "brain")


def test_revoked_identity_gets_no_roster_and_the_others_get_the_new_one(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    with computer(tmp_path / "brain") as brain:
        enroll(token_for(authority, running, "brain").encode())
    with computer(tmp_path / "base") as base:
        enroll(token_for(authority, running, "base").encode())
    lost = own_identity(brain, "brain").entry.common_name

    authority.revoke("brain")

    assert lost not in fetch_roster(base, "base", running.url).common_names()
    for ask in (fetch_roster, renew_own):
        with pytest.raises(AuthorityRefused, match=words_in_order("403", lost, "revoked")):
            ask(brain, "brain", running.url)


def test_machine_renews_its_certificate_while_the_earlier_one_counts(
    authority: Authority, running: AuthorityService, tmp_path: Path
) -> None:
    with computer(tmp_path / "brain") as folder:
        first = enroll(token_for(authority, running, "brain").encode())

    second = renew_own(folder, "brain", running.url)

    both = {first.entry.common_name, second.entry.common_name}
    assert len(both) == 2
    assert both <= set(fetch_roster(folder, "brain", running.url).common_names("machine"))
    assert own_identity(folder, "brain") == second
    for _ in range(2):
        renew_own(folder, "brain", running.url)
    with pytest.raises(CairnError, match=words_in_order("409", "4 certificates in force")):
        renew_own(folder, "brain", running.url)


def test_roster_remains_while_the_authority_does_not_answer(
    authority: Authority, tmp_path: Path
) -> None:
    with computer(tmp_path / "brain") as folder, serving(authority) as running:
        enroll(token_for(authority, running, "brain").encode())
    known = read_roster(folder)

    with pytest.raises(AuthorityUnreachable, match="cairn security serve"):
        fetch_roster(folder, "brain", running.url)

    assert read_roster(folder) == known


@pytest.mark.parametrize("path", ["/roster", "/renew"])
def test_certificate_is_needed(authority: Authority, running: AuthorityService, path: str) -> None:
    status, text = post(running, path, {}, authority.folder.ca)

    assert (status, "certificate" in text) == ((405, False) if path == "/roster" else (401, True))


@pytest.mark.parametrize("whose", ["other authority", "expired"])
def test_certificate_that_does_not_count_is_refused_by_tls(tmp_path: Path, whose: str) -> None:
    with days_ago(10):
        authority = new_authority(tmp_path / "authority", days=1)
    other = new_authority(tmp_path / "other")
    folder = (other if whose == "other authority" else authority).folder
    context = client_context(authority.folder.ca)
    context.load_cert_chain(folder.certificate("base"), folder.key("base"))

    with serving(authority) as running:
        address = running.url.removeprefix("https://")
        connection = http.client.HTTPSConnection(address, timeout=LIMIT_S, context=context)
        connection.request("GET", "/roster")  # the client's part of the handshake is done then
        with pytest.raises((ssl.SSLError, ConnectionError)):
            connection.getresponse()
        connection.close()


def test_service_does_not_speak_older_tls(authority: Authority, running: AuthorityService) -> None:
    context = client_context(authority.folder.ca)
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    address = running.url.removeprefix("https://")
    connection = http.client.HTTPSConnection(address, timeout=LIMIT_S, context=context)

    with pytest.raises(ssl.SSLError):
        connection.request("GET", "/ca")
    connection.close()


def test_requests_that_are_not_valid_are_refused(
    authority: Authority, running: AuthorityService
) -> None:
    def answer(body: Any, **headers: str) -> int:
        return post(running, "/enroll", body, authority.folder.ca, **headers)[0]

    whole = {"name": "brain", "secret": "0" * 64, "request": "no request"}
    assert answer(whole) == 400
    assert answer({**whole, "role": "administer"}) == 400
    assert answer(b"[" * 10_000) == 400
    assert answer(b" " * 20_000) == 413
    assert answer(whole, **{"Content-Type": "text/plain"}) == 415
    assert post(running, "/tokens", whole, authority.folder.ca)[0] == 404
    # A key of a kind that nothing knows: the last byte of id-ecPublicKey (RFC 5480) is another one.
    der = base64.b64decode("".join(request_for("brain").splitlines()[1:-1]))
    unknown = der.replace(bytes.fromhex("2a8648ce3d0201"), bytes.fromhex("2a8648ce3d0277"))
    text = base64.encodebytes(unknown).decode()
    pem = f"-----BEGIN CERTIFICATE REQUEST-----\n{text}-----END CERTIFICATE REQUEST-----\n"
    assert answer({**whole, "request": pem}) == 400


def test_service_certificate_is_renewed_after_a_day_of_the_clock(
    authority: Authority, running: AuthorityService
) -> None:
    file = authority.folder.path / "service.pem"
    before, now = file.read_bytes(), time.time()
    running.renew_if_due(now + 86_000)
    assert file.read_bytes() == before
    running.renew_if_due(now + 8 * 86_400)  # the computer was suspended for a week
    assert file.read_bytes() != before


def test_address_that_stands_for_all_needs_a_name(authority: Authority) -> None:
    with pytest.raises(CairnError, match=words_in_order("0.0.0.0", "by --name ADDRESS")):
        AuthorityService(authority, "0.0.0.0", 0)


def test_request_that_does_not_arrive_is_given_up(
    authority: Authority, running: AuthorityService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "_REQUEST_LIMIT_S", 0.05)
    declared = {"Content-Length": "100"}

    assert post(running, "/enroll", b"{", authority.folder.ca, **declared)[0] == 408


def test_wrong_tokens_of_an_address_are_limited(
    authority: Authority, running: AuthorityService
) -> None:
    request = certificates.new_request(certificates.new_key(), "brain").decode()
    body = {"name": "brain", "secret": "0" * 64, "request": request}

    answers = [post(running, "/enroll", body, authority.folder.ca)[0] for _ in range(7)]

    assert answers == [403] * 5 + [429] * 2


def test_wrong_attempts_are_counted_for_a_minute_in_bounded_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(service, "_MOST_ADDRESSES", 2)
    now = [0.0]
    wrong = WrongAttempts(lambda: now[0])
    for _ in range(5):
        assert not wrong.is_blocked("a")
        wrong.add("a")

    assert (wrong.is_blocked("a"), wrong.is_blocked("b")) == (True, False)
    wrong.add("b")
    assert wrong.is_blocked("c")
    now[0] = 60.0
    assert not any(map(wrong.is_blocked, "abc"))


def test_key_is_chosen_by_the_computer_and_nothing_else(
    authority: Authority, running: AuthorityService
) -> None:
    """The authority takes no name, role or address from a request."""
    key = certificates.new_key()
    token = token_for(authority, running, "alice")
    body = {
        "name": "alice",
        "secret": token.secret,
        "request": certificates.new_request(key, "machine.base.rover.00000000").decode(),
    }

    status, text = post(running, "/enroll", body, authority.folder.ca)

    assert status == 200
    made = certificates.read_certificate(json.loads(text)["certificate"].encode(), "answer")
    assert certificates.common_name(made).startswith(f"operator.alice.{ROBOT}.")


@given(st.one_of(st.text(max_size=200), st.text("abcAB01-_=.", max_size=80).map("cairn1.".__add__)))
def test_text_that_is_not_a_token_is_refused(text: str) -> None:
    with pytest.raises(CairnError, match="not a whole token"):
        decode_token(text)


@pytest.mark.parametrize("url", ["http://base:1", "https://base", "https://a@b:1", "https://b:1/x"])
def test_token_with_another_address_than_a_service_is_refused(url: str) -> None:
    made = Token.model_construct(url=url, ca="0" * 64, robot="r", name="n", secret="0" * 64)

    with pytest.raises(CairnError, match="not a whole token"):
        decode_token(made.encode())

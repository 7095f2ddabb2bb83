"""`cairn security`, as users run it: on the authority's computer and on a robot's."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cairn.security.computers import computer
from tests.commands import Answer, cairn
from tests.wording import assert_words

INIT = ("init", "--robot", "rover", "--machine", "base=127.0.0.1", "--operator", "alice=operate")


def security(*words: str) -> Answer:
    return cairn("security", *words)


def done(*words: str) -> Answer:
    answer = security(*words)
    assert answer.code == 0, answer.err
    return answer


def refused(*words: str) -> str:
    answer = security(*words)
    assert answer.code != 0, answer.out
    return answer.err


@contextmanager
def serving() -> Iterator[None]:
    """Run `cairn security serve` of the computer that is chosen now."""
    program = [sys.executable, "-m", "cairn.cli.program", "security", "serve"]
    program += ["--listen", "127.0.0.1:0"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert_words(process.stdout.readline(), "the authority answers at https://127.0.0.1:")
            yield
        finally:
            process.terminate()
    assert process.returncode == 0


def states() -> dict[str, list[str]]:
    """Return the states of all certificates by name, as `cairn security list` shows them."""
    found: dict[str, list[str]] = {}
    for row in done("list", "--json").json:
        found.setdefault(row["name"], []).append(row["state"])
    return found


@pytest.mark.processes
def test_robot_is_set_up_enrolled_renewed_and_revoked(tmp_path: Path) -> None:
    with computer(tmp_path / "laptop"):
        assert_words(done(*INIT).out, "ca.key secret", "machine base", "operator alice (operate)")
        assert_words(refused("token", "base"), "start the service first: cairn security serve")
        done("add", "brain", "--address", "127.0.0.1")
        assert_words(done("list").out, "valid until", "base", "machine", "in force", "alice")
        with serving():
            token = done("token", "brain", "--valid", "5m").out.strip()
            with computer(tmp_path / "brain"):
                assert_words(done("enroll", token).out, "machine brain", "brain.pem", "brain.key")
                assert_words(refused("enroll", token), "used already", "security token")
                assert_words(done("renew", "brain").out, "renewed machine brain")
                renewed = ["in force", "replaced, in force for a while"]
                assert states() == {"base": ["in force"], "alice": ["in force"], "brain": renewed}
            assert_words(refused("renew", "brain"), "its key is on its own computer")
            assert_words(done("renew", "--all").out, "operator alice", "renewed machine base")
            done("revoke", "alice")
            with computer(tmp_path / "brain"):
                assert_words(done("fetch").out, "roster of rover: version")
                assert set(states()["alice"]) == {"revoked"}
                assert_words(refused("renew"), "--all")
                assert_words(refused("renew", "brain", "--days", "9"), "security serve")
            done("revoke", "brain")
            with computer(tmp_path / "brain"):
                assert_words(refused("fetch"), "403", "revoked")
        with computer(tmp_path / "brain"):
            assert_words(refused("fetch"), "does not answer", "cairn security serve")


def test_identity_is_copied_by_hand(tmp_path: Path) -> None:
    file = str(tmp_path / "base.identity")
    with computer(tmp_path / "laptop"):
        done(*INIT)
        assert_words(done("export", "base", "--to", file).err, "private key of base", "remove it")
    with computer(tmp_path / "base"):
        assert_words(done("import", file).out, "machine base (127.0.0.1)", "ca.pem")
        assert_words(refused("revoke", "alice"), "ca.key", "run this on the computer of the")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("list",), "there are no certificates"),
        (("list", "--robot", "rover"), "no certificates of the robot rover"),
        (("init", "--robot", "../x"), "not a valid name"),
        (("init", "--robot", "x", "--machine", "base"), "NAME=VALUE"),
        (("init", "--robot", "x", "--machine", "base=::1,0.0.0.0"), "all addresses"),
        (("init", "--robot", "x", "--operator", "alice=root"), "'root' is not a role"),
        (("add", "x", "--address", "::1", "--role", "view"), "not both"),
        (("token", "x", "--valid", "15"), "15m"),
        (("token", "x", "--valid", "8d"), "at most 7d"),
        (("serve", "--listen", "7449"), "address and a port"),
        (("enroll", "cairn1.abc"), "not a whole token"),
    ],
)
def test_wrong_arguments_are_refused_with_the_remedy(words: tuple[str, ...], reason: str) -> None:
    assert reason in " ".join(refused(*words).split())


def test_robot_has_to_be_named_among_several(tmp_path: Path) -> None:
    with computer(tmp_path):
        for robot in ("rover", "digger"):
            done("init", "--robot", robot, "--machine", "base=::1")

        assert_words(refused("list"), "--robot", "digger, rover")
        assert done("list", "--robot", "digger", "--json").json[0]["name"] == "base"


def test_identities_follow_from_a_deployment_and_are_added_with_its_machines(
    tmp_path: Path,
) -> None:
    robot, machines = tmp_path / "rover.yaml", tmp_path / "machines.yaml"
    robot.write_text("cairn: 1\nrobot: rover\ncomponents: {talker: {plugin: test_talker}}\n")
    machines.write_text("machines: {base: {address: 10.0.0.1}, brain: {address: 10.0.0.2}}\n")
    of_robot = ("--deployment", str(robot), "--overlay", str(machines))
    with computer(tmp_path / "laptop"):
        assert_words(refused("init", "--deployment", str(robot)), "no `machines`", "--overlay")
        assert_words(refused("init", "--robot", "cart", *of_robot), "is rover; leave out --robot")
        assert_words(refused("init", "--robot", "rover", "--set", "x=1"), "give it by --deployment")
        answer = done("init", *of_robot, "--machine", "brain=brain.local", "--operator", "al=view")
        assert_words(answer.out, "machine base (10.0.0.1)", "machine brain (10.0.0.2, brain.local)")
        assert_words(answer.err, "next: ", "cairn security serve", "cairn security token")

        machines.write_text("machines: {base: {address: 10.0.0.9}, arm: {address: 10.0.0.3}}\n")
        assert_words(refused("add", "arm", *of_robot), "leave out NAME")
        answer = done("add", *of_robot)
        assert_words(answer.out, "machine arm (10.0.0.3)")
        assert_words(answer.err, "base: its address is 10.0.0.9", "cairn security revoke base")
        assert_words(answer.err, "brain: the deployment has no such machine")
        done("revoke", "base")
        assert_words(done("add", *of_robot).out, "machine base (10.0.0.9)")
        assert states() == {name: ["in force"] for name in ("arm", "base", "brain", "al")} | {
            "base": ["in force", "revoked"]
        }

"""`cairn schema`: list, show, import and export of types."""

import json
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from cairn import LATCHED
from cairn.bus.keys import EndpointEntity
from cairn.bus.type_hash import definition, type_description, type_hash
from cairn.deployment.message_types import find_message, messages_of_plugins
from cairn.deployment.plugins import installed_plugins
from cairn.errors import CairnError
from cairn.recording.mcap_file import McapFile
from cairn.schemas import interfaces
from cairn.schemas.interfaces import find_message as find_defined_message
from cairn.schemas.interfaces import interface
from cairn.schemas.message import classes_in, type_name
from cairn.schemas.package_files import import_packages
from cairn.system.kernel_compilation import deferred_compilation
from tests.cairn.bus.network import Network, eventually, node
from tests.commands import cairn
from tests.schemas.random_messages import HASHES
from tests.wording import assert_words, words_in_order


def test_list_has_messages_services_and_actions_with_their_modules() -> None:
    shown = cairn("schema", "list")

    assert (shown.code, shown.err) == (0, "")
    header, *rows = (line.split() for line in shown.out.splitlines())
    assert header == ["type", "module"]
    listed = dict(rows)
    assert listed["std_msgs/msg/String"] == "cairn.schemas.std_msgs.msg"
    assert listed["std_srvs/srv/Trigger"] == "cairn.schemas.std_srvs.srv"
    assert listed["nav2_msgs/action/Spin"] == "cairn.schemas.nav2_msgs.action"
    assert listed["cairn_msgs/msg/PortStatus"] == "cairn.schemas.cairn_msgs"
    named = {name for name in HASHES if "_" not in name.split("/")[2]}
    assert named <= set(listed)
    for name, module in listed.items():
        assert hasattr(import_module(module), name.split("/")[2]), name


def test_list_of_one_package_with_hashes() -> None:
    shown = cairn("schema", "list", "std_srvs", "--hash")

    rows = dict(line.split() for line in shown.out.splitlines()[1:])
    assert rows == {name: HASHES[name] for name in (
        "std_srvs/srv/Empty", "std_srvs/srv/SetBool", "std_srvs/srv/Trigger",
    )}  # fmt: skip
    as_json = cairn("schema", "list", "std_srvs", "--json").json
    assert {(row["type"], row["hash"], row["kind"]) for row in as_json} == {
        (name, HASHES[name], "service") for name in rows
    }
    assert_words(cairn("schema", "list", "std_srv").err, "no package std_srv", "std_srvs")


def test_service_and_action_are_shown_as_their_files_with_the_messages_in_them() -> None:
    service = cairn("schema", "show", "std_srvs/srv/SetBool").out.splitlines()
    assert service[:2] == ["# std_srvs/srv/SetBool", f"# {HASHES['std_srvs/srv/SetBool']}"]
    assert [line.partition(" #")[0].rstrip() for line in service[2:]] == [
        "bool data", "---", "bool success", "string message",
    ]  # fmt: skip

    action = cairn("schema", "show", "nav2_msgs/action/Spin").out
    assert "\nfloat32 target_yaw\n" in action
    assert "\nMSG: builtin_interfaces/Duration\n" in action
    assert "MSG: builtin_interfaces/Time" not in action  # which only ROS 2's own types need
    assert cairn("schema", "show", "std_msgs/Empty").out.startswith("# std_msgs/msg/Empty\n")
    assert cairn("schema", "show", "LaserScan").out.startswith("# sensor_msgs/msg/LaserScan\n")


def test_shown_json_has_the_official_type_description() -> None:
    for name in ("nav2_msgs/action/Spin", "std_srvs/srv/Trigger", "cairn_msgs/msg/PortStatus"):
        shown = cairn("schema", "show", name, "--json").json

        assert shown["description"] == type_description(interface(name))
        assert (shown["type"], shown["hash"]) == (name, type_hash(interface(name)))


def test_part_of_an_action_is_shown() -> None:
    shown = cairn("schema", "show", "nav2_msgs/action/Spin_FeedbackMessage").out
    assert "unique_identifier_msgs/UUID goal_id\n" in shown
    assert "MSG: nav2_msgs/action/Spin_Feedback\nfloat32 angular_distance_traveled" in shown


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("std_msgs/msg/Strng", ("unknown type std_msgs/msg/Strng", "std_msgs/msg/String")),
        ("Strng", ("unknown type Strng; did you mean", "std_msgs/msg/String?")),
        ("Empty", ("Empty: several packages have it", "std_msgs/msg/Empty, std_srvs/srv/Empty")),
        ("std_msgs/a/b/c", ("'std_msgs/a/b/c'", "not the name of a ROS 2 interface")),
        ("no_msgs/msg/X", ("unknown type no_msgs/msg/X", "cairn schema list")),
    ],
)
def test_unknown_type_is_reported_with_similar_ones(name: str, words: tuple[str, ...]) -> None:
    shown = cairn("schema", "show", name)
    assert shown.code == 1
    assert_words(shown.err, *words)


def test_service_is_not_found_as_a_message() -> None:
    with pytest.raises(CairnError, match=words_in_order("std_srvs/srv/Trigger", "not a message")):
        find_message("std_srvs/srv/Trigger")
    assert find_message("std_msgs/Empty") is interface("std_msgs/msg/Empty")


@pytest.mark.slow
def test_plugins_of_cairn_have_only_types_that_are_known_without_them() -> None:
    others = installed_plugins(of_cairn=False)
    assert others
    assert not any(plugin.target.startswith("cairn.") for plugin in others)
    with deferred_compilation():
        plugins = installed_plugins()
    for plugin in plugins:
        if plugin.target.startswith("cairn."):
            for port in plugin.ports:
                for message in classes_in(port.interface):
                    assert find_defined_message(type_name(message)) is message
    assert all(find_defined_message(name) is None for name in messages_of_plugins())


PACKAGE = {
    "clean_msgs/msg/Status.msg": "# State of the brushes.\nuint8 level\n",
    "clean_msgs/srv/Dock.srv": "---\nfar_msgs/Far far\n",
    "far_msgs/msg/Far.msg": "float32 x\n",
}


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    for name, text in PACKAGE.items():
        file = tmp_path / "src" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_import_prints_what_to_do_next(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = workspace / "my_robot"
    robot.mkdir()
    (robot / "__init__.py").touch()
    monkeypatch.chdir(workspace)

    shown = cairn("schema", "import", "src", "--into", "my_robot")

    assert (shown.code, shown.err) == (0, "")
    assert_words(
        shown.out,
        "wrote my_robot/clean_msgs: 1 message, 1 service",
        "wrote my_robot/far_msgs: 1 message",
        "from my_robot.clean_msgs.msg import Status",
        '[project.entry-points."cairn.messages"]',
        'clean_msgs = "my_robot.clean_msgs"',
        'far_msgs = "my_robot.far_msgs"',
    )
    assert cairn("schema", "import", "src", "--into", "my_robot").out == shown.out


def test_import_of_an_invalid_definition_names_file_and_line(workspace: Path) -> None:
    (workspace / "src/clean_msgs/msg/Status.msg").write_text("uint8 a\nuint8 b c\n")
    shown = cairn("schema", "import", str(workspace / "src"), "--into", str(workspace / "into"))
    assert shown.code == 1
    assert_words(shown.err, "Status.msg:2:", "'uint8 b c'")
    assert not (workspace / "into").exists()


def test_import_notes_what_it_leaves_out(workspace: Path) -> None:
    (workspace / "src/std_msgs/msg").mkdir(parents=True)
    (workspace / "src/std_msgs/msg/Bool.msg").write_text("uint8 data\n")
    (workspace / "src/far_msgs/msg/Wide.msg").write_text("wstring text\n")
    into = ("--into", str(workspace / "into"))

    shown = cairn("schema", "import", str(workspace / "src"), *into)

    assert shown.code == 0
    assert_words(shown.err, "left out std_msgs", "part of Cairn", "std_msgs/msg/Bool")
    assert_words(shown.err, "left out far_msgs/msg/Wide", "Wide.msg:1", "wstring")
    nothing = cairn("schema", "import", str(workspace / "src/std_msgs"), *into)
    assert (nothing.code, "nothing was imported" in nothing.err) == (1, True)


def test_import_into_a_folder_that_cannot_be_written(workspace: Path) -> None:
    (workspace / "file").touch()
    shown = cairn("schema", "import", str(workspace / "src"), "--into", str(workspace / "file"))
    assert shown.code == 1
    assert_words(shown.err, "file cannot be written")


@pytest.fixture
def network() -> Iterator[Network]:
    """A router, to which commands connect."""
    network = Network()
    yield network
    network.close()


class _Point:
    """An entry point of an installed package."""

    def __init__(self, name: str, value: str) -> None:
        self.name, self.value = name, value


@pytest.fixture
def installed(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[_Point]]:
    """Entry points of the group `cairn.messages`, with a registry of their own."""
    import_packages(workspace / "src", workspace / "python")
    monkeypatch.syspath_prepend(workspace / "python")
    points = [_Point("clean_msgs", "clean_msgs")]
    monkeypatch.setattr(interfaces, "_entry_points", lambda: tuple(points))
    monkeypatch.setattr(interfaces, "_registry", interfaces._Registry())
    before = set(sys.modules)
    yield points
    for name in set(sys.modules) - before:
        del sys.modules[name]


def test_types_of_installed_packages_are_known(installed: list[_Point]) -> None:
    rows = {row["type"]: row["module"] for row in cairn("schema", "list", "--json").json}

    assert rows["clean_msgs/srv/Dock"] == "clean_msgs.srv"
    assert_words(cairn("schema", "show", "clean_msgs/msg/Status").out, "# State of the brushes.")
    assert find_message("clean_msgs/msg/Status")().level == 0
    # The package that it refers to lies beside it.
    assert_words(
        cairn("schema", "show", "clean_msgs/srv/Dock").out, "MSG: far_msgs/Far", "float32 x"
    )
    assert cairn("schema", "list", "far_msgs").code == 0


@pytest.mark.accuracy
def test_invalid_type_does_not_hide_the_others(
    installed: list[_Point], workspace: Path, tmp_path: Path
) -> None:
    (workspace / "python/clean_msgs/msg/Status.msg").write_text("uint8 Level\n")

    shown = cairn("schema", "list", "clean_msgs", "--hash")
    rows = dict(line.split() for line in shown.out.splitlines()[1:])
    assert rows["clean_msgs/msg/Status"] == "invalid"
    assert rows["clean_msgs/srv/Dock"].startswith("RIHS01_")
    assert_words(shown.err, "left out clean_msgs/msg/Status", "Status.msg:1:", "'Level'")

    exported = cairn("schema", "export", str(tmp_path / "ros"))
    assert (exported.code, "left out clean_msgs/msg/Status" in exported.err) == (0, True)
    files = {file.name for file in (tmp_path / "ros/share/clean_msgs").rglob("*.*")}
    assert files == {"package.xml", "Dock.srv", "Dock.json"}


@pytest.mark.accuracy
def test_broken_package_does_not_hide_the_others(
    installed: list[_Point], workspace: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (workspace / "python" / "broken_msgs.py").write_text("1 / 0\n")
    (workspace / "python" / "plain_msgs.py").write_text("")
    installed[:0] = [_Point(name, name) for name in ("broken_msgs", "plain_msgs", "missing_msgs")]

    listed = cairn("schema", "list").out

    assert "clean_msgs/msg/Status" in listed
    assert_words(caplog.text, "broken_msgs", "ZeroDivisionError")
    assert_words(caplog.text, "plain_msgs", "is not a package")
    assert_words(caplog.text, "missing_msgs", "cannot be imported")
    assert cairn("schema", "show", "broken_msgs/msg/X").code == 1


def test_export_writes_an_ament_prefix_that_import_reads(tmp_path: Path) -> None:
    shown = cairn("schema", "export", str(tmp_path / "ros"))

    assert shown.code == 0
    assert f"export AMENT_PREFIX_PATH={tmp_path / 'ros'}" in shown.out
    share = tmp_path / "ros" / "share"
    for name in (*HASHES, "cairn_msgs/msg/PortStatus"):
        package, kind, last = name.split("/")
        if "_" in last:
            continue  # part of a service or action
        file = share / package / kind / f"{last}.{kind}"
        described = json.loads(file.with_suffix(".json").read_text())
        assert described == type_description(interface(name))
        assert file.is_file()
    assert "<name>nav_msgs</name>" in (share / "nav_msgs" / "package.xml").read_text()
    assert "BSD-3-Clause" in (share / "tf2_msgs" / "package.xml").read_text()
    assert (share / "ament_index/resource_index/packages/nav_msgs").is_file()

    imported = import_packages(share, tmp_path / "into")
    assert all(not differing for differing in imported.present.values())
    assert set(imported.written) == {name.split("/")[0] for name in messages_of_plugins()} | {
        "cairn_msgs",
        "cairn_nav_msgs",
        "cairn_sim_msgs",
    }


def test_export_again_renews_and_spares_what_it_did_not_write(tmp_path: Path) -> None:
    folder = tmp_path / "ros"
    assert cairn("schema", "export", str(folder)).code == 0
    old = folder / "share" / "std_msgs" / "msg" / "Old.msg"
    old.touch()
    assert cairn("schema", "export", str(folder)).code == 0
    assert not old.exists()

    foreign = tmp_path / "foreign"
    (foreign / "share" / "std_msgs").mkdir(parents=True)
    refused = cairn("schema", "export", str(foreign))
    assert refused.code == 1
    assert_words(refused.err, "std_msgs", "was not written by", "empty folder")
    assert [file.name for file in (foreign / "share").iterdir()] == ["std_msgs"]


@pytest.mark.processes
def test_types_that_no_component_has_imported_are_echoed_and_recorded(
    network: Network, tmp_path: Path
) -> None:
    endpoint = network.endpoint
    temperature = interface("sensor_msgs/msg/Temperature")
    feedback = interface("nav2_msgs/action/Spin_FeedbackMessage")
    robot = node(network.bus(), "/rover/thermometer")
    publishers = [
        robot.advertise("/rover/temperature", temperature, LATCHED),
        robot.advertise("/rover/spin/feedback", feedback, LATCHED),
    ]
    publishers[0].publish(temperature(temperature=21.5))
    publishers[1].publish(feedback(feedback={"angular_distance_traveled": 0.5}))
    assert eventually(
        lambda: (
            {"/rover/temperature", "/rover/spin/feedback"}
            <= {one.topic for one in network.graph() if isinstance(one, EndpointEntity)}
        )
    )
    echo = ("--count", "1", "--json")

    shown = cairn("topic", "echo", "/rover/temperature", *echo, connect=endpoint)
    assert shown.json["temperature"] == 21.5
    shown = cairn("topic", "echo", "/rover/spin/feedback", *echo, connect=endpoint)
    assert shown.json["feedback"] == {"angular_distance_traveled": 0.5}

    file = tmp_path / "drive.mcap"
    recorded = cairn("record", "--duration", "3", "-o", str(file), connect=endpoint)
    assert recorded.code == 0, recorded.err
    with McapFile(file) as recording:
        recording.index()
        found = {one.type: one.schema.decode() for one in recording.channels}
    assert found["sensor_msgs/msg/Temperature"] == definition(temperature)
    assert found["nav2_msgs/action/Spin_FeedbackMessage"] == definition(feedback)

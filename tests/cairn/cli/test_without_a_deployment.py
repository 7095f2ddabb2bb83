"""Commands that need no running deployment, and the errors of those that do."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cairn.cli.main import COMMANDS
from cairn.runtime.child_spec import ChildSpec
from cairn.testing.launching import CAIRN, new_endpoint
from tests.commands import cairn
from tests.patience import LIMIT_S
from tests.wording import assert_words


@pytest.mark.parametrize(
    "arguments",
    [
        ("ps",),
        ("graph",),
        ("logs",),
        ("topic", "list"),
        ("topic", "echo", "pose"),
        ("param", "list", "localizer"),
        ("restart", "localizer"),
    ],
)
def test_missing_running_deployment_is_reported_with_a_remedy(arguments: tuple[str, ...]) -> None:
    endpoint = new_endpoint()

    answer = cairn(*arguments, connect=endpoint)

    assert answer.code == 1
    assert answer.out == ""
    assert f"no router answers at {endpoint}" in answer.err
    assert "`cairn up`" in answer.err
    assert "--connect" in answer.err


def test_invalid_endpoint_is_rejected() -> None:
    answer = cairn("ps", "--connect", "localhost")

    assert answer.code == 1
    assert "--connect" in answer.err
    assert "'localhost' is not an endpoint; write " in answer.err


def test_check_accepts_a_deployment_without_problems(tmp_path: Path) -> None:
    file = tmp_path / "good.yaml"
    file.write_text("cairn: 1\ncomponents: {talker: {plugin: test_talker}}\n")

    assert_words(cairn("check", str(file)).out, str(file), "no problem", "talker")
    assert cairn("check", str(file), "--json").json == {
        "valid": True, "components": ["talker"], "warnings": [],
    }  # fmt: skip


def test_check_reports_all_problems_with_their_lines(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(
        "cairn: 1\nrobt: rover\ncomponents:\n  talker: {plugin: test_takler}\n"
        "  listener: {plugin: test_listener, parameters: {loud: 1}}\n"
    )

    answer = cairn("check", str(file))

    assert answer.code == 1
    assert_words(answer.err.splitlines()[0], "cairn", "3 problems")
    _, key, plugin, _ = answer.err.split(str(file))
    assert key.startswith(":2: robt: ")
    assert "did you mean robot?" in key
    assert plugin.startswith(":4: components.talker.plugin: ")
    assert "test_takler" in plugin
    assert f"{file}:5: components.listener.parameters.loud" in answer.err

    invalid = cairn("check", str(file), "--json")
    assert invalid.code == 1
    assert invalid.json["valid"] is False
    assert [(problem["line"], problem["path"]) for problem in invalid.json["problems"]] == [
        (2, "robt"),
        (4, "components.talker.plugin"),
        (5, "components.listener.parameters.loud"),
    ]


def test_set_and_overlay_change_the_checked_deployment(tmp_path: Path) -> None:
    file, overlay = tmp_path / "good.yaml", tmp_path / "over.yaml"
    file.write_text("cairn: 1\ncomponents: {talker: {plugin: test_talker}}\n")
    overlay.write_text("components: {beacon: {plugin: test_beacon}}\n")

    both = cairn("check", str(file), "--overlay", str(overlay), "--json")
    wrong = cairn("check", str(file), "--set", "components.talker.parameters.words=-1")

    assert both.json["components"] == ["talker", "beacon"]
    assert wrong.code == 1
    assert "--set components.talker.parameters.words=-1" in wrong.err


def test_plugins_are_listed_with_those_that_cannot_be_used() -> None:
    rows = {row["plugin"]: row for row in cairn("plugins", "--json").json}

    assert rows["automove"]["usable"]
    assert rows["test_talker"]["package"] == "cairn-test-plugins 0.1.0"
    assert rows["test_talker"]["writes"][0]["type"] == "geometry_msgs/msg/Twist"
    assert not rows["test_broken"]["usable"]
    assert "RuntimeError: this module is broken on purpose" in rows["test_broken"]["summary"]
    assert "Publishes the next number" in cairn("plugins").out


def test_one_plugin_is_shown_with_ports_and_parameters() -> None:
    shown = cairn("plugins", "test_talker")

    assert shown.code == 0
    assert "words  out        geometry_msgs/msg/Twist  reliable, volatile, depth 10" in shown.out
    assert "volume           3  >= 0, <= 11  Loudness [1]" in shown.out
    same = cairn("plugins", "cairn_test_plugins.talking:Talker", "--json").json
    assert [row["parameter"] for row in same["parameters"]] == ["words", "volume"]
    assert "did you mean test_talker?" in cairn("plugins", "test_takler").err


def test_schemas_are_listed_and_shown_for_other_languages() -> None:
    rows = {row["type"]: row for row in cairn("schema", "list", "--json").json}
    shown = cairn("schema", "show", "geometry_msgs/msg/Twist")

    twist = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
    assert rows["geometry_msgs/msg/Twist"]["hash"] == twist
    assert shown.out.startswith(f"# geometry_msgs/msg/Twist\n# {twist}\n# This expresses velocity")
    assert "\nVector3  linear\n" in shown.out
    as_json = cairn("schema", "show", "geometry_msgs/msg/Twist", "--json").json
    assert as_json["hash"] == twist
    assert cairn("schema", "show", "geometry_msgs/msg/Twst").code == 1


@pytest.fixture(scope="module")
def listed() -> str:
    """What `cairn --help` prints."""
    return cairn("--help").out


@pytest.mark.parametrize("command", [command.name for command in COMMANDS])
def test_help_lists_and_describes_every_command(listed: str, command: str) -> None:
    assert f"\n  {command} " in listed
    assert cairn(command, "--help").code == 0


def test_help_of_the_command_line_imports_no_implementation() -> None:
    script = (
        "import sys\nfrom cairn.cli.main import main\nsys.argv = ['cairn', '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print([one for one in ('numpy', 'zenoh', 'pydantic', 'rich') if one in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)

    assert shown.stdout.splitlines()[-1] == "[]"


def test_commands_that_only_send_requests_import_no_heavy_library() -> None:
    script = (
        "import sys\nimport cairn.cli.control, cairn.cli.topics, cairn.components.simulation.cli\n"
        "heavy = 'cv2', 'matplotlib', 'numba', 'plotext', 'scipy'\n"
        "print([one for one in heavy if one in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)

    assert shown.stdout == "[]\n"


def test_importing_cairn_imports_no_dependency() -> None:
    script = (
        "import cairn, sys\n"
        "print([one for one in ('numpy', 'zenoh', 'pydantic', 'typer') if one in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)

    assert shown.stdout == "[]\n"


@pytest.fixture
def other_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with two commands, one of which cannot be imported."""
    (tmp_path / "greeting.py").write_text(
        "def greet(number: str) -> None:\n    'Greet a number.'\n    print('hello,', number)\n"
    )
    (tmp_path / "failing.py").write_text("raise RuntimeError('broken on purpose')\n")
    info = tmp_path / "greeting-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: greeting\nVersion: 1.0\nSummary: Politeness\n"
    )
    (info / "entry_points.txt").write_text(
        "[cairn.commands]\ngreet = greeting:greet\nfail = failing:app\nps = greeting:greet\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures("other_package")
def test_installed_package_adds_commands_that_the_help_does_not_import() -> None:
    broken = "command fail (failing:app) cannot be loaded: RuntimeError('broken on purpose')"

    shown = cairn("--help")
    assert "greeting" not in sys.modules
    assert "Installed by other packages:" in shown.out
    assert re.search(r"^  greet +greeting 1\.0: Politeness$", shown.out, re.MULTILINE)
    assert (shown.code, shown.err) == (0, "")
    assert cairn("greet", "-5").out == "hello, -5\n"
    assert broken in cairn("fail").err
    assert "Greet" not in cairn("ps", "--help").out  # a command of Cairn's own is not replaced


def test_help_has_complete_summaries_of_all_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    groups = [(), ("topic",), ("param",), ("map",), ("object",), ("world",), ("recording",)]
    for columns in ("80", "100"):
        monkeypatch.setenv("COLUMNS", columns)
        for group in groups:
            shown = cairn(*group, "--help").out
            assert "..." not in shown.partition("Commands")[2]
            assert max(map(len, shown.splitlines())) <= int(columns)


def test_shell_completion_knows_commands_and_deployments() -> None:
    def completed(*words: str) -> list[str]:
        environment = {
            **os.environ,
            "_CAIRN_COMPLETE": "complete_bash",
            "COMP_WORDS": " ".join(words),
            "COMP_CWORD": str(len(words) - 1),
        }
        done = subprocess.run([CAIRN], env=environment, capture_output=True, text=True)
        return done.stdout.split()

    assert completed("cairn", "resta") == ["restart"]
    assert "sim" in completed("cairn", "up", "s")


def test_missing_deployment_is_reported_with_those_that_exist() -> None:
    assert_words(cairn("up").err, "Missing argument 'FILE'", "robot", "sim")
    assert "did you mean sim?" in cairn("check", "simm").err


def test_own_command_that_cannot_be_imported_is_reported_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cairn.cli.check", None)  # the import of it fails

    error = cairn("check", "sim").err

    assert_words(error, "command check (cairn.cli.check:check) cannot be loaded", "install")
    assert "uninstall" not in error


def test_help_of_load_names_the_setting_as_it_is_in_a_deployment() -> None:
    setting = re.search(r"`load: (\w+)`", cairn("load", "--help").out)

    assert setting is not None
    spec = ChildSpec.model_validate({"plugin": "test_reader", "load": setting[1]})
    assert spec.load == "on_request"


# Prints tables: where a standard stream is closed, lines alone would not fail.
TABLE = [CAIRN, "plugins", "test_talker"]


def test_full_disk_under_the_output_is_reported() -> None:
    with Path("/dev/full").open("wb") as full:
        listed = subprocess.run(
            TABLE,
            stdout=full,
            stderr=subprocess.PIPE,
            timeout=LIMIT_S,
            text=True,
        )

    assert listed.returncode == 1
    assert_words(listed.stderr, "cairn", "output", "No space left on device")


def test_command_works_with_closed_standard_streams() -> None:
    def close_all() -> None:
        for number in range(3):
            os.close(number)

    listed = subprocess.run(TABLE, preexec_fn=close_all, timeout=LIMIT_S)

    assert listed.returncode == 0

"""Packages of interfaces: those that Cairn ships are up to date; import of other definitions."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module, invalidate_caches
from itertools import count
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from cairn.bus.codec import Codec
from cairn.bus.message_limits import length_of
from cairn.errors import CairnError
from cairn.schemas import interfaces, package_files
from cairn.schemas.definitions import DefinitionError
from cairn.schemas.interfaces import interface, packages
from cairn.schemas.message import InvalidMessage
from cairn.schemas.package_files import find_packages, import_packages, module_files
from tests.schemas.random_messages import RandomMessages
from tests.wording import words_in_order

_numbers = count(1)

Write = Callable[[Path, dict[str, str]], Path]


@pytest.fixture
def name() -> str:
    """A name of a package that no other test has: a process has one package of each name."""
    return f"test{next(_numbers)}_msgs"


@pytest.fixture(autouse=True)
def _registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packages of these tests are unknown to the others."""
    monkeypatch.setattr(interfaces, "_registry", interfaces._Registry())


@pytest.fixture
def python_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder from which Python imports."""
    folder = tmp_path / "python"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    return folder


def written(folder: Path, files: dict[str, str]) -> Path:
    """Write files into a folder, and return it."""
    for relative, text in files.items():
        file = folder / relative
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text), encoding="utf-8")
    return folder


def imported_module(name: str) -> Any:
    invalidate_caches()
    return import_module(name)


SHIPPED = {
    name: folder
    for name, folder in packages().items()
    if folder.parent == Path(package_files.__file__).parent
}


@pytest.mark.parametrize("package", SHIPPED)
def test_shipped_modules_and_stubs_are_those_of_the_definitions(package: str) -> None:
    folder = SHIPPED[package]
    for relative, text in module_files(package, folder).items():
        assert (folder / relative).read_text(encoding="utf-8") == text, (
            f"schemas/{package}/{relative} is not up to date: python -m cairn.schemas.package_files"
        )
    stubs = {str(file.relative_to(folder)) for file in folder.glob("*/__init__.py*")}
    assert stubs <= set(module_files(package, folder))


ODD = """
    Inner[3] three
    Inner[<=2] few
    string[2] names
    string<=5[<=3] short_names ["a", "b"]
    string<=4[2] pair
    string<=3 tag "abc"
    bool[4] flags
    bool[<=4] some
    byte[2] raw
    char letter 65
    float32[<=3] numbers [1.5, 2.5]
    int64 least -9223372036854775808
    uint64 most 18446744073709551615
    geometry_msgs/Point[2] corners
    std_msgs/Header header
    std_msgs/Empty nothing
    uint8 A=1
    string S="x y"
    float64 PI=3.14
    bool YES=true
    """


def test_unusual_fields_are_sent_and_limited(tmp_path: Path, python_path: Path, name: str) -> None:
    source = written(
        tmp_path / name,
        {"msg/Odd.msg": ODD, "msg/Inner.msg": "int32 x\nstring text\nstd_msgs/Empty[] many\n"},
    )
    import_packages(source, python_path)
    odd = imported_module(f"{name}.msg").Odd
    codec, random = Codec(), RandomMessages(1)

    assert (odd().tag, odd().letter, odd().short_names, odd().least) == (
        "abc",
        65,
        ("a", "b"),
        -(2**63),
    )
    assert (odd.A, odd.S, odd.PI, odd.YES) == (1, "x y", 3.14, True)
    assert len(odd().three) == 3
    for message in (odd(), *(random.make(odd) for _ in range(200))):
        encoded = codec.encode(message)
        assert codec.decode(odd, encoded) == message
        assert hash(codec.decode(odd, encoded)) == hash(message)
        assert length_of(message) <= len(encoded)
    invalid: dict[str, list[Any]] = {
        "three": [(), (random.make(odd).three[0],) * 2],
        "few": [(odd().three[0],) * 3],
        "names": [("a",), ("a", "b", "c")],
        "short_names": [("abcdef",), ("äöü",), ("a",) * 4],
        "pair": [("a", "abcde")],
        "tag": ["abcd", "äb\x00"],
        "flags": [[True]],
        "some": [[True] * 5],
        "raw": [[1], [1, 256]],
        "numbers": [[1.0] * 4],
        "corners": [()],
    }
    for field, values in invalid.items():
        for value in values:
            with pytest.raises(InvalidMessage, match=field):
                odd(**{field: value})


def test_bounds_are_checked_in_received_messages(
    tmp_path: Path, python_path: Path, name: str
) -> None:
    files = {"msg/Loose.msg": "string[] a\nuint16[] b\nInner[] c\n", "msg/Inner.msg": "int8 x\n"}
    files["msg/Strict.msg"] = "string<=2[<=2] a\nuint16[<=2] b\nInner[<=2] c\n"
    import_packages(written(tmp_path / name, files), python_path)
    msg = imported_module(f"{name}.msg")
    codec = Codec()

    valid = codec.encode(msg.Loose(a=("ab", ""), b=[1, 2], c=(msg.Inner(), msg.Inner())))
    assert codec.decode(msg.Strict, valid).a == ("ab", "")
    for field, value in {"a": ("abc",), "b": [1, 2, 3], "c": (msg.Inner(),) * 3}.items():
        with pytest.raises(InvalidMessage, match=words_in_order("Strict", field)):
            codec.decode(msg.Strict, codec.encode(msg.Loose(**{field: value})))
    with pytest.raises(InvalidMessage, match=words_in_order("Strict", "a")):
        codec.decode(msg.Strict, codec.encode(msg.Loose(a=("", "", ""))))


# Names that the code generated for a message could use itself.
NAMES = [
    "self", "cls", "args", "kwargs", "name", "value", "field", "make", "made", "message",
    "tuple", "len", "type", "list", "dict", "set", "int", "str", "float", "bool", "bytes",
    "hash", "id", "max", "min", "isinstance", "object", "super", "property", "print",
    "exec", "compile", "check", "copy", "json", "model_config", "model_fields", "fields",
    "schema", "validate", "rawdata", "pos", "size", "raw", "position", "element", "count",
    "register", "match", "case", "default", "x", "d", "t", "val", "buf", "cdr",
]  # fmt: skip


@pytest.mark.parametrize("kind", ["string", "string<=3[<=4]", "float32[<=2]", "bool[]", "Inner[]"])
def test_fields_may_have_any_name(tmp_path: Path, python_path: Path, name: str, kind: str) -> None:
    lines = "".join(f"{kind} {field}\n" for field in NAMES)
    files = {"msg/Names.msg": lines, "msg/Inner.msg": "int8 tuple\n"}
    import_packages(written(tmp_path / name, files), python_path)
    names = imported_module(f"{name}.msg").Names
    codec, random = Codec(), RandomMessages(2)

    for _ in range(20):
        message = random.make(names)
        assert codec.decode(names, codec.encode(message)) == message


def test_services_and_actions_have_their_parts(
    tmp_path: Path, python_path: Path, name: str
) -> None:
    files = {
        "srv/Do.srv": "int32 a\n---\nbool done\n",
        "action/Go.action": "int32 goal\n---\nint32 result\n---\nint32 feedback\n",
    }
    import_packages(written(tmp_path / name, files), python_path)
    do, go = imported_module(f"{name}.srv").Do, imported_module(f"{name}.action").Go

    assert do.Request(a=3).a == 3
    assert do.Response(done=True).done
    assert go.Goal(goal=1).goal == 1
    assert go.SendGoal.Request().goal == go.Goal()
    assert go.FeedbackMessage(feedback=go.Feedback(feedback=2)).feedback.feedback == 2
    assert interface(f"{name}/action/Go_SendGoal_Request") is go.SendGoal.Request


def test_package_inside_of_a_package_is_imported_from_there(
    tmp_path: Path, python_path: Path, name: str
) -> None:
    source = written(tmp_path / "src", {
        f"{name}/msg/One.msg": f"{name}_b/Two two\n",
        f"{name}_b/msg/Two.msg": "int32 x 7\n",
    })  # fmt: skip
    robot = written(python_path / f"robot_of_{name}", {"__init__.py": ""})
    import_packages(source, robot)

    module = imported_module(f"robot_of_{name}.{name}.msg")

    assert module.One().two.x == 7
    assert type(module.One().two).__module__ == f"robot_of_{name}.{name}_b.msg"
    assert (
        f"from ...{name}_b import msg as {name}_b"
        in (robot / name / "msg/__init__.pyi").read_text()
    )


def test_import_again_renews_and_removes(tmp_path: Path, name: str) -> None:
    source = written(
        tmp_path / name,
        {"msg/A.msg": "B b\n", "msg/B.msg": "int8 x\n", "srv/Do.srv": "---\n"},
    )
    into = tmp_path / "into"
    import_packages(source, into)
    (source / "msg" / "B.msg").unlink()
    (source / "srv" / "Do.srv").unlink()
    (source / "msg" / "A.msg").write_text("int16 other\n")

    import_packages(source, into)

    found = sorted(str(one.relative_to(into / name)) for one in (into / name).rglob("*.*"))
    assert found == ["__init__.py", "msg/A.msg", "msg/__init__.py", "msg/__init__.pyi"]
    assert not (into / name / "srv").exists()
    assert (into / name / "msg" / "A.msg").read_text() == "int16 other\n"
    assert "other: field_types.Int16" in (into / name / "msg" / "__init__.pyi").read_text()


def test_import_into_the_package_itself_keeps_the_definitions(tmp_path: Path, name: str) -> None:
    source = written(tmp_path / name, {"msg/A.msg": "int8 x\n"})
    for _ in range(2):
        import_packages(source, tmp_path)
    assert (source / "msg" / "A.msg").read_text() == "int8 x\n"
    assert (source / "msg" / "__init__.pyi").is_file()


def test_foreign_folder_is_not_overwritten(tmp_path: Path, name: str) -> None:
    source = written(tmp_path / "src" / name, {"msg/A.msg": "int8 x\n"})
    into = written(tmp_path / "into", {f"{name}/__init__.py": "SOMETHING = 1\n"})

    with pytest.raises(CairnError, match=words_in_order(name, "was not written by", "--into")):
        import_packages(source, into)
    assert (into / name / "__init__.py").read_text() == "SOMETHING = 1\n"
    assert not (into / name / "msg").exists()


def test_workspace_is_read_as_colcon_reads_it(tmp_path: Path) -> None:
    workspace = written(tmp_path, {
        "src/repository/a_msgs/msg/A.msg": "int8 x\n",
        "src/b_folder/package.xml": "<package><name> b_msgs </name></package>",
        "src/b_folder/srv/B.srv": "---\n",
        "install/COLCON_IGNORE": "",
        "install/a_msgs/share/a_msgs/msg/A.msg": "int8 x\n",
        ".git/c_msgs/msg/C.msg": "int8 x\n",
    })  # fmt: skip

    assert find_packages(workspace) == {
        "a_msgs": workspace / "src/repository/a_msgs",
        "b_msgs": workspace / "src/b_folder",
    }
    assert list(find_packages(workspace / "install")) == ["a_msgs"]


def test_share_folder_leaves_out_what_cairn_has_and_what_it_does_not_support(
    tmp_path: Path, name: str
) -> None:
    share = written(tmp_path / "share", {
        "std_msgs/msg/String.msg": "# another text\nstring data\n",
        "std_msgs/msg/Bool.msg": "uint8 data\n",
        f"{name}/msg/Good.msg": "std_msgs/String text\n",
        f"{name}/msg/Wide.msg": "wstring text\n",
        f"{name}/msg/WithWide.msg": "Wide[] texts\n",
        f"{name}/srv/AskWide.srv": "---\nWithWide wide\n",
    })  # fmt: skip

    imported = import_packages(share, tmp_path / "into")

    assert list(imported.written) == [name]
    assert imported.present == {"std_msgs": ["std_msgs/msg/Bool"]}
    assert set(imported.left_out) == {
        f"{name}/msg/Wide", f"{name}/msg/WithWide", f"{name}/srv/AskWide",
    }  # fmt: skip
    assert "wstring" in imported.left_out[f"{name}/msg/Wide"]
    assert f"contains {name}/msg/Wide" in imported.left_out[f"{name}/msg/WithWide"]
    copies = {
        str(file.relative_to(tmp_path / "into" / name))
        for file in (tmp_path / "into" / name).rglob("*.*")
    }
    assert copies == {"__init__.py", "msg/Good.msg", "msg/__init__.py", "msg/__init__.pyi"}


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({}, ("there is no file msg/*.msg",)),
        (
            {"x_msgs/msg/A.msg": "int8 x\nB b\n"},
            ("A.msg:2:", "field b", "x_msgs/msg/B", "define it"),
        ),
        (
            {"x_msgs/msg/A.msg": "no_such_msgs/B b\n"},
            ("A.msg:1:", "no_such_msgs/msg/B", "import package no_such_msgs together"),
        ),
        ({"x_msgs/srv/A.srv": "---\nstd_msgs/Strng b\n"}, ("A.srv:2:", "std_msgs/msg/Strng")),
        ({"x_msgs/msg/A.msg": "int8 x y\n"}, ("A.msg:1:",)),
        ({"x_msgs/msg/A.msg": "A a\n"}, ("contains itself", "x_msgs/msg/A")),
        (
            {"x_msgs/msg/A.msg": "B[] a\n", "x_msgs/msg/B.msg": "A[3] b\n"},
            ("contains itself", "x_msgs/msg/"),
        ),
        (
            {"x_msgs/msg/A.msg": "y_msgs/B a\n", "y_msgs/msg/B.msg": "x_msgs/A b\n"},
            ("contains itself",),
        ),
        (
            {"x_msgs/msg/lower.msg": "int8 x\n"},
            ("lower.msg", "'lower'", "not the name of an interface"),
        ),
        ({"x_msgs/msg/None.msg": "int8 x\n"}, ("None.msg", "'None'")),
        ({"x_msgs/msg/A_B.msg": "int8 x\n"}, ("A_B.msg", "'A_B'")),
        ({"X-msgs/msg/A.msg": "int8 x\n"}, ("'X-msgs'", "not the name of a ROS 2 package")),
        ({"class/msg/A.msg": "int8 x\n"}, ("'class'", "not the name of a ROS 2 package")),
        (
            {"a/x_msgs/msg/A.msg": "int8 x\n", "b/x_msgs/msg/A.msg": "int8 x\n"},
            ("x_msgs is defined twice",),
        ),
    ],
)
def test_invalid_sources_are_rejected_before_anything_is_written(
    tmp_path: Path, files: dict[str, str], words: tuple[str, ...]
) -> None:
    source = written(tmp_path / "src", files)
    source.mkdir(exist_ok=True)

    with pytest.raises(DefinitionError, match=words_in_order(*words)):
        import_packages(source, tmp_path / "into")
    assert not (tmp_path / "into").exists()


def test_source_that_is_not_a_folder_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match="is not a folder"):
        import_packages(tmp_path / "missing", tmp_path / "into")


def test_message_that_contains_itself_is_rejected_when_it_is_used(
    tmp_path: Path, python_path: Path, name: str
) -> None:
    source = written(tmp_path / name, {"msg/A.msg": "B b\n", "msg/B.msg": "int8 x\n"})
    import_packages(source, python_path)
    (python_path / name / "msg" / "B.msg").write_text("A a\n")

    with pytest.raises(DefinitionError, match=words_in_order("A.msg", "contains itself")):
        imported_module(f"{name}.msg").A  # noqa: B018 - the access is the test


def test_deeply_nested_messages_are_rejected(tmp_path: Path, python_path: Path, name: str) -> None:
    files = {f"msg/M{n}.msg": f"M{n + 1} a\nM{n + 1}[] b\n" for n in range(300)}
    import_packages(written(tmp_path / name, files | {"msg/M300.msg": "int8 x\n"}), python_path)
    msg = imported_module(f"{name}.msg")

    with pytest.raises(DefinitionError, match="more than 100 other types"):
        msg.M0  # noqa: B018 - the access is the test
    assert len(Codec().encode(msg.M230())) > 70


USER = """
    import numpy as np
    from cairn import Component, Server, serve
    from robot_msgs.action import Go
    from robot_msgs.msg import Status
    from robot_msgs.srv import Do

    from cairn.schemas.geometry_msgs.msg import Point


    class Worker(Component):
        do: Server[Do.Request, Do.Response] = Server()

        @serve("do")
        def on_do(self, request: Do.Request) -> Do.Response:
            where: Point = request.status.where
            return Do.Response(done=request.status.level > Status.HIGH and where.x > 0.0)


    goal = Go.Goal(distance=1.5)
    status = Status(level=3, where=Point(x=1.0), names=("a",), values=np.zeros(2))
    """
WRONG = {
    "Status(levl=3)": "levl",
    'Status(level="high")': "level",
    "Do.Request().done": "done",
    "Go.Goal(distance=())": "distance",
    "Server[Do.Request, Do.Respons]": "Respons",
    "Status().names.append": "append",
}


@pytest.mark.accuracy
@pytest.mark.slow
def test_mypy_knows_the_imported_classes(tmp_path: Path) -> None:
    source = written(tmp_path / "src", {
        "robot_msgs/msg/Status.msg": (
            "uint8 HIGH=2\nuint8 level\ngeometry_msgs/Point where\nstring[] names\n"
            "float64[] values\n"
        ),
        "robot_msgs/srv/Do.srv": "Status status\n---\nbool done\n",
        "robot_msgs/action/Go.action": "float64 distance\n---\n---\nother_msgs/Far far\n",
        "other_msgs/msg/Far.msg": "float32 x\n",
    })  # fmt: skip
    import_packages(source, tmp_path)
    wrong = "\n".join(f"{text}  # line {number}" for number, text in enumerate(WRONG))
    (tmp_path / "user.py").write_text(dedent(USER))
    (tmp_path / "wrong.py").write_text(f"{dedent(USER)}\n{wrong}\n")

    found = dict(_errors_of_mypy(tmp_path))

    assert "user.py" not in found, found
    first = len(dedent(USER).splitlines()) + 2
    for number, word in enumerate(WRONG.values()):
        assert word in found["wrong.py"].get(first + number, ""), (word, found)


def _errors_of_mypy(folder: Path) -> Iterator[tuple[str, dict[int, str]]]:
    """Yield the errors in user.py and wrong.py, by line."""
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--no-error-summary",
        "user.py",
        "wrong.py",
    ]
    shown = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert shown.stderr == ""
    for file in ("user.py", "wrong.py"):
        lines = [line for line in shown.stdout.splitlines() if line.startswith(f"{file}:")]
        errors = {int(line.split(":")[1]): line for line in lines if ": error:" in line}
        if errors:
            yield file, errors

"""The parser of .msg, .srv and .action files: what it accepts, and how it rejects the rest."""

import keyword
import string
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cairn.schemas.definitions import (
    PLACEHOLDER,
    ConstantDefinition,
    DefinitionError,
    FieldDefinition,
    UnsupportedDefinition,
    full_type_name,
    parse_definitions,
    read_definitions,
)
from cairn.schemas.field_types import INTEGER_LIMITS
from tests.wording import words_in_order

_NUMBERS = ("bool", "float32", "float64", *INTEGER_LIMITS)
_PACKAGES = st.sampled_from(["my_msgs", "a1_msgs"])
_FIELD_NAMES = st.from_regex("[a-z](_?[a-z0-9]){0,8}", fullmatch=True).filter(
    lambda name: not keyword.iskeyword(name)
)


def parsed(text: str, kind: str = "msg") -> Any:
    """Return what a file defines, a message of it if it is one."""
    found = parse_definitions(text, f"my_msgs/{kind}/One", f"One.{kind}")
    return found["my_msgs/msg/One"] if kind == "msg" else found


def error_of(text: str, kind: str) -> str:
    """Return the reason for which a file is rejected, "" if it is not."""
    try:
        parsed(text, kind)
    except DefinitionError as error:
        return str(error)
    return ""


def fields_in(text: str) -> list[FieldDefinition]:
    return list(parsed(text).fields)


@given(st.text(max_size=300), st.sampled_from(["msg", "srv", "action"]))
@example("[" * 10_000, "msg")
@example("int32[] a " + "[" * 5_000, "msg")
@example("int32[] a " + "-" * 100_000 + "1", "msg")
@example("int64 a " + "9" * 10_000, "msg")
@example("float64 a 1e" + "9" * 400, "msg")
@example("string A='", "msg")
@example('string<=0 a "x"', "msg")
@example("int32[<=0] a", "msg")
@example("int32[2] a {1: 2}", "msg")
@example("bool[1] a [maybe]", "msg")
@example("\x00", "msg")
@example("uint8", "msg")
@example("uint8 =1", "msg")
@example("\ud800 a", "msg")
def test_any_text_is_a_definition_or_a_definition_error(text: str, kind: str) -> None:
    error = error_of(text, kind)
    assert error == "" or (f"One.{kind}" in error and len(error) < 2_000)


# Random text is seldom close to a definition; random words of the language are.
_WORDS = st.sampled_from(
    ["int32", "string", "bool", "float64", "byte", "char", "wstring", "Point", "a/B", "a/msg/B",
     "[", "]", "<=", "3", "[3]", "[<=3]", "=", "A", "a", "b", "-1", "1.5", "true", "'x'", '"y"',
     "[1, 2]", "#", "---", "\n", " ", "\t", "_", "a_", "A_B", "nan"]
)  # fmt: skip


@given(st.lists(_WORDS, max_size=30).map("".join), st.sampled_from(["msg", "srv", "action"]))
def test_any_words_are_a_definition_or_a_definition_error(text: str, kind: str) -> None:
    error = error_of(text, kind)
    assert error == "" or f"One.{kind}" in error


@st.composite
def _fields(draw: st.DrawFn) -> FieldDefinition:
    element = draw(st.sampled_from([*_NUMBERS, "string", "geometry_msgs/msg/Point"]))
    text_most = draw(st.none() | st.integers(0, 200)) if element == "string" else None
    count, most = draw(
        st.sampled_from([(None, None), (0, None), (3, None), (1, None), (0, 1), (0, 250)])
    )
    default = None
    if "/" not in element and draw(st.booleans()):
        one = _values(element, text_most)
        size = st.integers(0, 3) if most is None or most > 3 else st.just(1)
        if count is None:
            default = draw(one)
        else:
            length = count or draw(size)
            default = tuple(draw(one) for _ in range(length))
    return FieldDefinition(draw(_FIELD_NAMES), element, count, most, text_most, default)


def _values(element: str, text_most: int | None = None) -> st.SearchStrategy[Any]:
    if element == "bool":
        return st.booleans()
    if element == "string":
        letters = string.ascii_letters + string.digits + " _.,:;äß'"
        return st.text(letters, max_size=min(6, (text_most if text_most is not None else 12) // 2))
    if element.startswith("float"):
        return st.floats(allow_nan=False, allow_infinity=False)
    return st.integers(*INTEGER_LIMITS[element])


def _written(one: FieldDefinition) -> str:
    bound = "" if one.text_most is None else f"<={one.text_most}"
    many = ""
    if one.count is not None:
        many = f"[{one.count or ''}]" if one.most is None else f"[<={one.most}]"
    default = one.default
    if default is None:
        text = ""
    elif one.element == "string" and one.count is None:
        text = f'"{default}"'
    else:
        text = repr(list(default) if isinstance(default, tuple) else default)
    return f"{one.element}{bound}{many} {one.name} {text}".rstrip()


@given(
    st.lists(_fields(), max_size=8, unique_by=lambda one: one.name),
    st.sampled_from([" ", "  ", "\t"]),
    st.sampled_from(["", "   # a comment: int32 x", "# [1, 2]", "\t"]),
    st.sampled_from(["\n", "\r\n", "\n\n# comment\n   \n"]),
)
def test_written_fields_are_read_again(
    fields: list[FieldDefinition], blank: str, comment: str, end: str
) -> None:
    lines = [_written(one).replace(" ", blank, 1) + comment for one in fields]
    found = fields_in(end.join(lines))

    expected = [
        FieldDefinition(
            one.name,
            "uint8" if one.element == "char" else one.element,
            one.count,
            one.most,
            one.text_most,
            one.default,
        )
        for one in fields
    ]
    assert found == (expected or [FieldDefinition(PLACEHOLDER, "uint8")])


@given(st.sampled_from([*_NUMBERS, "string"]).flatmap(lambda e: st.tuples(st.just(e), _values(e))))
def test_written_constants_are_read_again(constant: tuple[str, Any]) -> None:
    element, value = constant
    text = f'"{value}"' if element == "string" else str(value)

    (found,) = parsed(f"{element} SOME_NAME={text}").constants
    (same,) = parsed(f"{element}   SOME_NAME  =  {text}  # comment").constants

    expected = ConstantDefinition("SOME_NAME", "uint8" if element == "char" else element, value)
    assert found == same == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("int32 a 0x1F", 31),
        ("int32 a 007", 7),
        ("int32 a -5", -5),
        ("bool a True", True),
        ("bool a 0", False),
        ("float32 a 1", 1.0),
        ("string a hello world", "hello world"),
        ('string a "it\'s"', "it's"),
        ('string a "say \\"x\\""', 'say "x"'),
        ('string a ""', ""),
        ("bool[] a [true, false, True]", (True, False, True)),
        ('string[] a ["true story", "b"]', ("true story", "b")),
        ("float64[2] a [1, 2.5]", (1.0, 2.5)),
        ("char a 65", 65),
    ],
)
def test_default_value(text: str, expected: object) -> None:
    (one,) = fields_in(text)
    assert one.default == expected
    assert type(one.default) is type(expected)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("int32", ("''", "not the name of a field")),
        ("int33 a", ("no type int33",)),
        ("int32 A", ("'A'", "not the name of a field")),
        ("int32 a__b", ("not the name of a field",)),
        ("int32 a_", ("not the name of a field",)),
        ("int32 _a", ("not the name of a field",)),
        ("int32 h" + 60 * "9" + "!", ("not the name of a field",)),
        ("int32 H" + 60 * "9" + "!=1", ("not the name of a field",)),
        ("int32 a 2147483648", ("2147483648 is not a int32", "2147483647")),
        ("uint8 a -1", ("-1 is not a uint8",)),
        ("bool a maybe", ("'maybe' is not a bool",)),
        ("float64 a x", ("x",)),
        ("string<=3 a abcd", ("'abcd' is longer than 3 bytes",)),
        ("int32<=3 a", ("only a string or a sequence has a bound",)),
        ("int32[0] a", ("1 to 1000000 elements",)),
        ("int32[<=] a", ("1 to 1000000 elements",)),
        ("int32[9999999] a", ("1 to 1000000 elements",)),
        ("int32[2] a [1]", ("an array of 2 has 1 default values",)),
        ("int32[<=1] a [1, 2]", ("2 default values, more than 1",)),
        ("int32[] a 5", ("'5' is not a list",)),
        ("Point a 1", ("only fields of primitive types have a default",)),
        ("int32[] A=1", ("a constant is a single number",)),
        ("Point A=1", ("a constant is a single number",)),
        ("int32 A=", ("A=",)),
        ("a/b/C x", ("a/b/C", "is not a type")),
        ("Point<=3 a", ("only a string or a sequence has a bound",)),
    ],
)
def test_error_names_file_line_and_reason(line: str, words: tuple[str, ...]) -> None:
    text = f"# a comment\n\nfloat64 good\n{line}\nfloat64 better"
    with pytest.raises(DefinitionError, match=words_in_order("One.msg:4:", *words)):
        parsed(text)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        *((f"int32 {word}", (f"named {word}", "keyword")) for word in ("class", "from", "lambda")),
        ("wstring a", ("wstring is not supported", "use string")),
        ("wstring<=5[] a", ("wstring is not supported",)),
        ("string[1001] a", ("more than 1000 strings or messages",)),
        ("Point[1001] a", ("more than 1000 strings or messages",)),
    ],
)
def test_what_is_not_supported_is_an_error_of_its_own(line: str, words: tuple[str, ...]) -> None:
    with pytest.raises(UnsupportedDefinition, match=words_in_order("One.msg:2:", *words)):
        parsed(f"int8 a\n{line}")


def test_name_that_is_defined_twice_is_rejected() -> None:
    with pytest.raises(DefinitionError, match=words_in_order("One.msg:3:", "a is defined twice")):
        parsed("int32 a\nint32 b\nfloat64 a")
    with pytest.raises(DefinitionError, match=words_in_order("One.msg:2:", "A is defined twice")):
        parsed("int32 A=1\nint32 A=2")


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("msg", "int32 a\n---\nint32 b"),
        ("srv", "int32 a"),
        ("srv", "---\n---"),
        ("action", "---"),
        ("action", "---\n---\n---"),
    ],
)
def test_wrong_number_of_parts_is_rejected(kind: str, text: str) -> None:
    with pytest.raises(DefinitionError, match=words_in_order(f"One.{kind}", "parts", "---")):
        parsed(text, kind)


def test_error_in_the_second_part_names_the_line_in_the_file() -> None:
    with pytest.raises(DefinitionError, match=words_in_order("One.srv:4:")):
        parsed("int32 a\n---\n# comment\nint32 B", "srv")


def test_empty_parts_have_the_placeholder() -> None:
    found = parsed("---\n---", "action")
    for part in ("Goal", "Result", "Feedback"):
        assert [one.name for one in found[f"my_msgs/action/One_{part}"].fields] == [PLACEHOLDER]


def test_type_without_a_package_is_of_the_same_package() -> None:
    text = "Inner a\nmsg/Inner b\nmy_msgs/Inner c\nmy_msgs/msg/Inner d"
    assert {one.element for one in fields_in(text)} == {"my_msgs/msg/Inner"}


def test_long_files_take_linear_time(tmp_path: Path) -> None:
    file = tmp_path / "One.msg"
    file.write_text("# comment\n" * 100_000 + "int32 a\n")
    (one,) = read_definitions(file, "my_msgs/msg/One")["my_msgs/msg/One"].fields
    assert (one.name, one.line) == ("a", 100_001)

    file.write_text("".join(f"int8 a{n}\n" for n in range(50_000)))
    with pytest.raises(DefinitionError, match=words_in_order("One.msg:1001:", "at most 1000")):
        read_definitions(file, "my_msgs/msg/One")

    file.write_text("int8 a\n" * (1 << 20))
    with pytest.raises(DefinitionError, match=words_in_order("One.msg", "cannot be read")):
        read_definitions(file, "my_msgs/msg/One")


def test_file_that_is_not_text_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "One.msg"
    file.write_bytes(b"int32 a # \xff\xfe")
    with pytest.raises(DefinitionError, match=words_in_order("One.msg", "cannot be read")):
        read_definitions(file, "my_msgs/msg/One")
    with pytest.raises(DefinitionError, match="cannot be read"):
        read_definitions(tmp_path / "Missing.msg", "my_msgs/msg/One")


@given(
    _PACKAGES,
    st.sampled_from(["msg", "srv", "action"]),
    st.from_regex("[A-Z][A-Za-z0-9]{0,9}", fullmatch=True),
)
def test_full_type_name(package: str, kind: str, last: str) -> None:
    assert full_type_name(f"{package}/{kind}/{last}") == f"{package}/{kind}/{last}"
    assert full_type_name(f"{package}/{last}") == f"{package}/msg/{last}"


@given(st.text(max_size=50))
def test_any_other_name_is_a_definition_error(name: str) -> None:
    with pytest.raises(DefinitionError, match="std_msgs/msg/String"):
        full_type_name(f"{name}!")

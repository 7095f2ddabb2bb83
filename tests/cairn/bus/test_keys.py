"""rmw_zenoh's wire conventions, against captured traffic and the examples of its design page.

Keys, hashes and tokens: https://github.com/ros2/rmw_zenoh/blob/rolling/docs/design.md; the
attachment was captured from a Humble talker.
"""

import pytest
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st

from cairn import LATCHED, RELIABLE, SENSOR, Qos
from cairn.bus.keys import (
    Attachment,
    EndpointEntity,
    NodeEntity,
    WireFormatError,
    data_key,
    dds_type,
    gid,
    parse_qos_chunk,
    parse_token,
    qos_chunk,
    ros_type,
    token_key,
)
from cairn.bus.type_hash import type_hash
from cairn.schemas.message import type_name
from cairn.schemas.std_msgs import String

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ADD_TWO_INTS = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
LISTENER = NodeEntity(2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, "/listener")
TALKER = NodeEntity(2, "8b20917502ee955ac4476e0266340d5c", 0, "/talker")
SERVER = NodeEntity(2, "f9980ee0495eaafb3e38f0d19e2eae12", 0, "/add_two_ints_server")
LOCALIZER = NodeEntity(0, "1f", 3, "/robot/nav/localizer")

TOKENS: list[tuple[str, NodeEntity | EndpointEntity]] = [
    ("@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener", LISTENER),
    (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/"
        f"std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,",
        EndpointEntity(LISTENER, 10, "MS", "/chatter", "std_msgs/msg/String", STRING, RELIABLE),
    ),
    (
        "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
        f"std_msgs::msg::dds_::String_/{STRING}/::,7:,:,:,,",
        EndpointEntity(
            TALKER, 10, "MP", "/chatter", "std_msgs/msg/String", STRING, RELIABLE.with_depth(7)
        ),
    ),
    (
        "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
        f"example_interfaces::srv::dds_::AddTwoInts_/{ADD_TWO_INTS}/::,10:,:,:,,",
        EndpointEntity(
            SERVER, 10, "SS", "/add_two_ints", "example_interfaces/srv/AddTwoInts", ADD_TWO_INTS,
            RELIABLE,
        ),
    ),
    ("@ros2_lv/0/1f/3/3/NN/%/%robot%nav/localizer", LOCALIZER),
    (
        "@ros2_lv/0/1f/3/12/MP/%/%robot%nav/localizer/%robot%pose/"
        f"std_msgs::msg::dds_::String_/{STRING}/2:1:,5:,:,:,,",
        EndpointEntity(
            LOCALIZER, 12, "MP", "/robot/pose", "std_msgs/msg/String", STRING,
            Qos("best_effort", "transient_local", 5),
        ),
    ),
]  # fmt: skip


def test_token_of_dora_is_parsed() -> None:
    # Captured from dora-rs 1.1.0: the id of a node in its session is its name.
    token = "@ros2_lv/0/b54ec680e3336816cf74f645a53e7d0a/dora/1/NN/%/%ros/dora"
    node = NodeEntity(0, "b54ec680e3336816cf74f645a53e7d0a", "dora", "/ros/dora")
    assert parse_token(token) == node


def test_topic_has_the_data_key_of_rmw_zenoh() -> None:
    assert data_key(0, "/robot1/chatter", type_name(String), type_hash(String)) == (
        "0/robot1/chatter/std_msgs::msg::dds_::String_/"
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_service_has_the_data_key_of_rmw_zenoh() -> None:
    assert data_key(2, "/add_two_ints", "example_interfaces/srv/AddTwoInts", ADD_TWO_INTS) == (
        "2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/"
        "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    )


def test_captured_attachment_is_decoded_and_encoded() -> None:
    captured = bytes.fromhex("d80000000000000034dae10162f8c41810f07168d3856ce9f689254cbed6252151")
    attachment = Attachment.decode(captured)
    assert attachment.sequence == 216
    assert attachment.sent_ns == 0x18C4F86201E1DA34
    assert attachment.gid.hex() == "f07168d3856ce9f689254cbed6252151"
    assert attachment.encode() == captured


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachment_equals_that_of_zenohs_own_serializer(
    sequence: int, sent_ns: int, gid: bytes
) -> None:
    attachment = Attachment(sequence, sent_ns, gid)
    theirs = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(sent_ns), gid))
    assert attachment.encode() == theirs.to_bytes()
    assert Attachment.decode(attachment.encode()) == attachment


def test_proof_of_an_exclusive_writer_follows_what_rmw_zenoh_reads() -> None:
    attachment = Attachment(7, 8, bytes(range(16)), bytes(range(24)))

    data = attachment.encode()

    # rmw_zenoh deserializes one value after the other and ignores what follows (also in C++).
    head = (zenoh.ext.Int64(7), zenoh.ext.Int64(8), bytes(range(16)))
    assert data.startswith(zenoh.ext.z_serialize(head).to_bytes())
    whole = (*head, bytes(range(24)))
    assert data == zenoh.ext.z_serialize(whole).to_bytes()
    assert Attachment.decode(data) == attachment


@pytest.mark.parametrize(
    "data",
    [
        b"", bytes(32), bytes(33), bytes(34), b"x" * 10_000,
        bytes(16) + b"\x10" + bytes(17), bytes(16) + b"\x10" + bytes(16 + 25),
    ],
)  # fmt: skip
def test_malformed_attachment_is_rejected(data: bytes) -> None:
    with pytest.raises(WireFormatError, match="33 bytes") as rejected:
        Attachment.decode(data)
    assert len(str(rejected.value)) < 200


def test_gid_is_the_little_endian_xxh3_of_the_token() -> None:
    # XXH3's published test value for no input: high 99aa06d3014798d8, low 6001c324468d497f.
    assert gid("").hex() == "7f498d4624c30160" + "d8984701d306aa99"
    assert len({gid(token) for token, _ in TOKENS}) == len(TOKENS)


@pytest.mark.parametrize(("key", "entity"), TOKENS)
def test_tokens_are_written_and_parsed(key: str, entity: NodeEntity | EndpointEntity) -> None:
    assert token_key(entity) == key
    assert parse_token(key) == entity


def test_security_enclave_is_kept() -> None:
    key = "@ros2_lv/0/1f/3/3/NN/%acme%arm/%/driver"
    node = parse_token(key)
    assert node == NodeEntity(0, "1f", 3, "/driver", enclave="/acme/arm")
    assert token_key(node) == key


def test_tokens_of_humble_without_type_hash_are_parsed() -> None:
    key = TOKENS[1][0].replace(STRING, "TypeHashNotSupported")
    endpoint = parse_token(key)
    assert isinstance(endpoint, EndpointEntity)
    assert endpoint.type_hash == "TypeHashNotSupported"


@pytest.mark.parametrize(
    "key",
    [
        "",
        "/",
        "@ros2_lv",
        "0/chatter/std_msgs::msg::dds_::String_/RIHS01_0",
        "@ros2_lv/2/aa/0/0/NN/%/%",
        "@ros2_lv/2/aa/0/0/NN/%/%/listener/more",
        "@ros2_lv/2/aa/0/0/MP/%/%/listener",
        "@ros2_lv/2//0/0/NN/%/%/listener",
        "@ros2_lv/two/aa/0/0/NN/%/%/listener",
        "@ros2_lv/-2/aa/0/0/NN/%/%/listener",
        "@ros2_lv/2/aa/0/\u0663/NN/%/%/listener",
        f"@ros2_lv/2/aa/0/{'1' * 5000}/NN/%/%/listener",
        TOKENS[1][0].replace("/MS/", "/NN/"),
        TOKENS[1][0].replace("/MS/", "/XX/"),
        TOKENS[1][0].replace("::dds_::", "::"),
        TOKENS[1][0].replace("String_", "_"),
        TOKENS[1][0].replace("std_msgs::", "::"),
        TOKENS[1][0] + "/",
        TOKENS[1][0] + "x",
        "@ros2_lv/2/aa/0/0/NN/%/%/listener\x1b[2J",
        "@ros2_lv/2/aa/0/0/NN/%/%/listener\n2026-11-23 INFO",
        "@ros2_lv/2/aa/0/0/NN/%/%/list\u0435ner",
    ],
)
def test_malformed_token_is_rejected(key: str) -> None:
    with pytest.raises(WireFormatError) as rejected:
        parse_token(key)
    assert len(str(rejected.value)) < 500


@given(st.text("@ros2_lv/0123%NMPS:,dx", max_size=80))
def test_any_key_is_parsed_or_rejected(text: str) -> None:
    for key in (text, f"@ros2_lv/2/aa/0/1/{text}", f"@ros2_lv/2/aa/0/1/MP/%/%/n/%t/{text}"):
        try:
            entity = parse_token(key)
        except WireFormatError:
            continue
        assert parse_token(token_key(entity)) == entity


@pytest.mark.parametrize(
    ("qos", "chunk"),
    [
        (RELIABLE, "::,10:,:,:,,"),
        (SENSOR, "2::,5:,:,:,,"),
        (LATCHED, ":1:,1:,:,:,,"),
        (RELIABLE.with_depth(42), "::,:,:,:,,"),
        (SENSOR.with_depth(42), "2::,:,:,:,,"),
    ],
)
def test_qos_is_written_and_parsed(qos: Qos, chunk: str) -> None:
    assert qos_chunk(qos) == chunk
    assert parse_qos_chunk(chunk) == qos


@pytest.mark.parametrize(
    ("chunk", "qos"),
    [
        ("1:2:1,10:,:,:,,", RELIABLE),
        ("0:0:0,0:,:,:,,", RELIABLE.with_depth(42)),
        ("::2,:,:,:,,", RELIABLE.with_depth(42)),
        (":1:,3:1,500000000:0,0:2,5,0", LATCHED.with_depth(3)),
    ],
)
def test_qos_of_other_implementations_is_parsed(chunk: str, qos: Qos) -> None:
    assert parse_qos_chunk(chunk) == qos


@pytest.mark.parametrize(
    "chunk",
    ["", "::", "9::,10:,:,:,,", "a::,10:,:,:,,", "::,-1:,:,:,,", "::,ten:,:,:,,", "::10:,:,:,,",
     "::,10:,:,:,", "::,10:,:,:,,,", "::,10:,:,:,,:", "::,10:x,:,:,,", "::,\u0661:,:,:,,",
     f"::,{'9' * 9000}:,:,:,,", "::,10:,:,:,,\n"],
)  # fmt: skip
def test_malformed_qos_is_rejected(chunk: str) -> None:
    with pytest.raises(WireFormatError, match="is not a QoS chunk") as rejected:
        parse_qos_chunk(chunk)
    assert len(str(rejected.value)) < 500


def test_type_names_are_converted_both_ways() -> None:
    assert dds_type("nav_msgs/msg/Odometry") == "nav_msgs::msg::dds_::Odometry_"
    assert ros_type("nav_msgs::msg::dds_::Odometry_") == "nav_msgs/msg/Odometry"


def test_depth_below_one_is_rejected() -> None:
    with pytest.raises(ValueError, match="depth = 0"):
        RELIABLE.with_depth(0)

"""Names and discovery against the sources of rmw_fastrtps, rmw_dds_common and rmw_zenoh."""

import struct

import pytest

from lirs_extensions.live.graph import (
    DISCOVERY_TYPE,
    LiveTopic,
    discovery_message,
    type_hash,
    typestore,
    user_data,
    zenoh_attachment,
    zenoh_key,
    zenoh_token,
)

SCAN = LiveTopic("/scan", "sensor_msgs/msg/LaserScan")
HASH = "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
"""Of sensor_msgs/msg/LaserScan in ROS 2's own interface packages, as ros-z quotes it."""


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_hash_and_user_data_are_those_of_jazzy_and_kilted(distribution):
    assert type_hash(SCAN.kind, distribution) == HASH
    # rmw_dds_common/src/qos.cpp, encode_type_hash_for_user_data_qos: "typehash=" + hash + ";"
    assert user_data(SCAN.kind, distribution) == f"typehash={HASH};".encode()


@pytest.mark.parametrize(("distribution", "length"), [("humble", 24), ("jazzy", 16), ("kilted", 16)])
def test_discovery_message_has_the_layout_of_its_definition(distribution, length):
    """rmw_dds_common/msg: ParticipantEntitiesInfo, NodeEntitiesInfo, Gid (24 bytes, from Iron on 16)."""
    participant, reader, writer = (bytes([k] * 16) for k in (1, 2, 3))
    message = discovery_message(participant, [reader], [writer, writer], distribution)
    gid = {guid: guid.ljust(length, b"\0") for guid in (participant, reader, writer)}
    node = struct.pack("<I", 2) + b"/\0" + b"\0\0" + struct.pack("<I", 9) + b"lirs_wct\0" + b"\0\0\0"
    expected = b"\0\1\0\0" + gid[participant] + struct.pack("<I", 1) + node
    expected += struct.pack("<I", 1) + gid[reader] + struct.pack("<I", 2) + 2 * gid[writer]
    assert message == expected
    assert (
        typestore(distribution).deserialize_cdr(message, DISCOVERY_TYPE).node_entities_info_seq[0].node_name
    )


def test_zenoh_keys_are_rmw_zenohs():
    """rmw_zenoh_cpp/src/detail/liveliness_utils.cpp, TopicInfo::TopicInfo; Humble's branch has no hash."""
    assert zenoh_key(SCAN, 3, "jazzy") == f"3/scan/sensor_msgs::msg::dds_::LaserScan_/{HASH}"
    assert zenoh_key(SCAN, 0, "humble") == "0/scan/sensor_msgs::msg::dds_::LaserScan_/TypeHashNotSupported"
    raw = LiveTopic("/imu/data_raw", "sensor_msgs/msg/Imu")
    assert zenoh_key(raw, 0, "jazzy").startswith("0/imu/data_raw/sensor_msgs::msg::dds_::Imu_/RIHS01_")


def test_zenoh_tokens_are_rmw_zenohs():
    """rmw_zenoh_cpp/src/detail/liveliness_utils.cpp, Entity::Entity and mangle_name ('/' becomes '%')."""
    assert zenoh_token("abc", 0, 0, "jazzy") == "@ros2_lv/0/abc/0/0/NN/%/%/lirs_wct"
    assert zenoh_token("abc", 7, 5, "jazzy", SCAN, "MP") == (
        "@ros2_lv/5/abc/0/7/MP/%/%/lirs_wct/%scan/sensor_msgs::msg::dds_::LaserScan_/"
        + HASH
        + "/::,10:,:,:,,"
    )
    # qos_to_keyexpr of the same file; defaults in src/detail/qos.cpp: reliable, volatile, keep last.
    durable = zenoh_token("abc", 7, 5, "jazzy", LiveTopic("/a", SCAN.kind, 1, durable=True), "MP")
    assert durable.endswith("/:1:,1:,:,:,,")


def test_zenoh_attachment_has_33_bytes():
    """rmw_zenoh_cpp/src/detail/attachment_helpers.cpp: int64, int64, array of 16 bytes with its length."""
    attachment = zenoh_attachment(2, 3, bytes(range(16)))
    assert attachment == b"\2" + bytes(7) + b"\3" + bytes(7) + b"\x10" + bytes(range(16))

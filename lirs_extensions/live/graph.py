"""Names, quality of service and discovery of topics as ROS 2 nodes expect them.

The strings follow rmw_dds_common (`ros_discovery_info`, `typehash=`), rmw_fastrtps (`rt/` prefix, enclave)
and rmw_zenoh (keys, liveliness tokens, attachments).
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from lirs_extensions.live.options import Distribution
from lirs_wct.errors import ConfigError
from lirs_wct.formats.rosbag.topics import LATCHED, TOPICS

STORES: dict[Distribution, Stores] = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
}
"""Message definitions by ROS distribution."""
NODE = "lirs_wct"
"""Name of our node."""
DISCOVERY_TOPIC, DISCOVERY_TYPE = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
ENCLAVE = b"enclave=/;"
"""User data of a DDS participant that is a ROS context."""
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
MAP_TYPE, TRANSFORMS_TYPE = "nav_msgs/msg/OccupancyGrid", "tf2_msgs/msg/TFMessage"
POSE, POSE_TYPE, EMPTY = "/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "std_msgs/msg/Empty"
NO_HASH = "TypeHashNotSupported"
"""Hash of a type in rmw_zenoh for Humble."""


@dataclass(frozen=True)
class LiveTopic:
    """A topic with type and quality of service; always reliable, keep last.

    Attributes:
        name: with the leading slash.
        kind: type of its messages, such as `sensor_msgs/msg/LaserScan`.
        depth: messages that are kept.
        durable: whether late subscribers get the last messages (transient local).
    """

    name: str
    kind: str
    depth: int = 10
    durable: bool = False


PUBLISHED = tuple(
    LiveTopic(
        name, kind, 1 if name in LATCHED else 100 if name in ("/tf", "/imu/data_raw") else 10, name in LATCHED
    )
    for name, kind in TOPICS.items()
)
"""Topics that a drive can publish."""
SUBSCRIBED = (
    LiveTopic("/cmd_vel", TWIST),
    LiveTopic("/cmd_vel", TWIST_STAMPED),
    LiveTopic("/map", MAP_TYPE, 1),
    LiveTopic("/tf", TRANSFORMS_TYPE, 100),
    LiveTopic(POSE, POSE_TYPE),
    LiveTopic("/initialpose", POSE_TYPE),
    LiveTopic("/reset", EMPTY),
)
"""Topics that a client may publish."""


@cache
def typestore(distribution: Distribution) -> Typestore:
    """Return the message types of a distribution."""
    return get_typestore(STORES[distribution])


def dds_type(kind: str) -> str:
    """Return a type's name in DDS and Zenoh.

    >>> dds_type("sensor_msgs/msg/LaserScan")
    'sensor_msgs::msg::dds_::LaserScan_'
    """
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def type_hash(kind: str, distribution: Distribution) -> str | None:
    """Return a type's RIHS01 hash (REP 2016); None in Humble, which has none."""
    if distribution == "humble":
        return None
    found: str = typestore(distribution).hash_rihs01(kind)
    return found


def user_data(kind: str, distribution: Distribution) -> bytes:
    """Return the user data of a DDS endpoint."""
    found = type_hash(kind, distribution)
    return b"" if found is None else f"typehash={found};".encode()


def discovery_message(
    participant: bytes, readers: Sequence[bytes], writers: Sequence[bytes], distribution: Distribution
) -> bytes:
    """Return the message on `ros_discovery_info` that assigns endpoints to our node, by 16 bytes each."""
    store = typestore(distribution)
    types: Any = store.types
    length = store.fielddefs["rmw_dds_common/msg/Gid"][1][0][1][1][1]

    def gid(guid: bytes) -> Any:
        return types["rmw_dds_common/msg/Gid"](np.frombuffer(guid.ljust(length, b"\0"), np.uint8))

    node = types["rmw_dds_common/msg/NodeEntitiesInfo"](
        "/", NODE, [gid(guid) for guid in readers], [gid(guid) for guid in writers]
    )
    return bytes(store.serialize_cdr(types[DISCOVERY_TYPE](gid(participant), [node]), DISCOVERY_TYPE))


def zenoh_key(topic: LiveTopic, domain: int, distribution: Distribution) -> str:
    """Return the key expression of a topic's messages in rmw_zenoh."""
    hashed = type_hash(topic.kind, distribution) or NO_HASH
    return f"{domain}/{topic.name.strip('/')}/{dds_type(topic.kind)}/{hashed}"


def zenoh_token(
    zid: str,
    entity: int,
    domain: int,
    distribution: Distribution,
    topic: LiveTopic | None = None,
    kind: str = "NN",
) -> str:
    """Return the token of our node (NN), or of a topic's publisher (MP) or subscription (MS).

    The entity is a number in the session of identifier `zid`.
    """
    node = f"@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/%/{NODE}"
    if topic is None:
        return node
    hashed = type_hash(topic.kind, distribution) or NO_HASH
    name = topic.name.replace("/", "%")
    # Quality of service without rmw_zenoh's default values: transient local or volatile, and the depth.
    quality = f":{1 if topic.durable else ''}:,{topic.depth}:,:,:,,"
    return f"{node}/{name}/{dds_type(topic.kind)}/{hashed}/{quality}"


def zenoh_attachment(sequence: int, nanoseconds: int, gid: bytes) -> bytes:
    """Return the attachment of a message in rmw_zenoh: 33 bytes.

    The publisher of 16 bytes `gid` counts its messages from 1. The wall time is that since 1970.
    """
    return struct.pack("<qqB16s", sequence, nanoseconds, len(gid), gid)


LOOPBACK, ANY_ADDRESS = "127.0.0.1", "0.0.0.0"
CYCLONE_LOOPBACK = (
    f'<General><Interfaces><NetworkInterface address="{LOOPBACK}"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    f'<Peers><Peer address="{LOOPBACK}"/></Peers></Discovery>'
)
"""`CYCLONEDDS_URI` of a client on loopback; by default Cyclone DDS uses another interface alone."""


class Received(NamedTuple):
    """A message of a client on a topic of SUBSCRIBED, in CDR."""

    topic: LiveTopic
    cdr: bytes


class Middleware(Protocol):
    """Connection to the clients: publishers and subscriptions of one ROS node."""

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        """Send a message, in CDR, on a topic of PUBLISHED."""
        ...

    def receive(self, seconds: float = 0.0) -> list[Received]:
        """Return new messages. Wait for the first one at most so long."""
        ...

    def subscribers(self, topic: str) -> int:
        """Return the present number of subscribers of a topic; with Zenoh, 1 = any."""
        ...

    def publishers(self) -> int:
        """Return the present number of publishers on topics of SUBSCRIBED; Zenoh does not tell: 1."""
        ...

    def close(self) -> None:
        """Leave the network."""
        ...


def own_address(host: str | None) -> str:
    """Return the IPv4 address of one of this machine's interfaces; None = loopback."""
    if host is None:
        return LOOPBACK
    try:
        address = socket.gethostbyname(host)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "no name of a machine"
        raise ConfigError(f"--host {host}: no address of this machine: {reason}") from error
    if address == ANY_ADDRESS:
        raise ConfigError(f"--host {host!r}: needs one address of this machine, not all")
    return address

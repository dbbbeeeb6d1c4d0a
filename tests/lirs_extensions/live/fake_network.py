"""A middleware without network, and messages of a client."""

from typing import Any

import numpy as np

from lirs_extensions.live.graph import SUBSCRIBED, TWIST, TWIST_STAMPED, LiveTopic, Received, typestore

STORE: Any = typestore("jazzy")
TYPES: Any = STORE.types


def topic(name: str, kind: str | None = None) -> LiveTopic:
    return next(t for t in SUBSCRIBED if t.name == name and kind in (None, t.kind))


def header(nanoseconds: int, frame: str = "base_link") -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
    return TYPES["std_msgs/msg/Header"](stamp, frame)


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return TYPES["geometry_msgs/msg/Vector3"](x, y, z)


def received(to: LiveTopic, message: Any) -> Received:
    return Received(to, bytes(STORE.serialize_cdr(message, to.kind)))


def twist(v: float, omega: float) -> Any:
    return TYPES[TWIST](vector(v), vector(z=omega))


def stamped(nanoseconds: int, v: float, omega: float = 0.0) -> Received:
    message = TYPES[TWIST_STAMPED](header(nanoseconds), twist(v, omega))
    return received(topic("/cmd_vel", TWIST_STAMPED), message)


def quaternion(yaw: float) -> Any:
    return TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def frame(nanoseconds: int, x: float, y: float, yaw: float, parent: str = "map", child: str = "odom") -> Any:
    T = TYPES["geometry_msgs/msg/Transform"](vector(x, y), quaternion(yaw))
    return TYPES["geometry_msgs/msg/TransformStamped"](header(nanoseconds, parent), child, T)


def frames(*transforms: Any) -> Received:
    return received(topic("/tf"), TYPES["tf2_msgs/msg/TFMessage"](list(transforms)))


def pose(x: float, y: float, yaw: float) -> Any:
    point = TYPES["geometry_msgs/msg/Point"](x, y, 0.0)
    return TYPES["geometry_msgs/msg/Pose"](point, quaternion(yaw))


def start(x: float, y: float, yaw: float, *, name: str = "/initialpose", variance: float = 0.0) -> Received:
    inner = TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(x, y, yaw), variance * np.eye(6).ravel())
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    return received(topic(name), TYPES[kind](header(0, "map"), inner))


def grid(cells: list[list[int]], resolution: float, origin: tuple[float, float, float]) -> Received:
    data = np.array(cells, np.int8)
    rows, columns = data.shape
    time = TYPES["builtin_interfaces/msg/Time"](0, 0)
    info = TYPES["nav_msgs/msg/MapMetaData"](time, resolution, columns, rows, pose(*origin))
    return received(topic("/map"), TYPES["nav_msgs/msg/OccupancyGrid"](header(0, "map"), info, data.ravel()))


class FakeNetwork:
    """Network with one client, a function of each published message that returns the client's messages.

    Attributes:
        sent: topics and bytes, in order.
    """

    def __init__(self, client: Any = lambda topic, message: []) -> None:
        self._client, self.sent, self._waiting = client, [], []

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        self.sent.append((topic, bytes(message)))
        self._waiting += self._client(topic, bytes(message))

    def send(self, *messages: Received) -> None:
        """Send messages of the client unasked."""
        self._waiting += messages

    def receive(self, seconds: float = 0.0) -> list[Received]:
        found, self._waiting = self._waiting, []
        return found

    def subscribers(self, topic: str) -> int:
        return 1

    def publishers(self) -> int:
        return 1

    def close(self) -> None:
        pass


def stamp_of(message: bytes) -> int:
    """Return the stamp of a message that begins with a header, nanoseconds."""
    seconds, nanoseconds = np.frombuffer(message[4:12], "<i4,<u4")[0].tolist()
    return int(seconds * 10**9 + nanoseconds)

"""Interface of the middlewares."""

from __future__ import annotations

import socket
from typing import NamedTuple, Protocol

from lirs_extensions.live.graph import LiveTopic
from lirs_wct.errors import ConfigError

LOOPBACK, ANY_ADDRESS = "127.0.0.1", "0.0.0.0"
CYCLONE_LOOPBACK = (
    f'<General><Interfaces><NetworkInterface address="{LOOPBACK}"/></Interfaces></General>'
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    f'<Peers><Peer address="{LOOPBACK}"/></Peers></Discovery>'
)
"""`CYCLONEDDS_URI` of a client on loopback; by default Cyclone DDS uses another interface alone."""


class Received(NamedTuple):
    """A message of a client.

    Attributes:
        topic: One of SUBSCRIBED.
        cdr: bytes of the message.
    """

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
    """Return the IPv4 address of one of this machine's interfaces; None = loopback.

    Raises:
        ConfigError: the host is no address of this machine.
    """
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

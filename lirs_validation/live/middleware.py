"""Interface of the middlewares."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from lirs_validation.live.graph import LiveTopic


class Received(NamedTuple):
    """A message of a client.

    Attributes:
        topic: of SUBSCRIBED.
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

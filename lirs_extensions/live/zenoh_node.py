"""A ROS 2 node over Zenoh, as rmw_zenoh's nodes, by the package eclipse-zenoh."""

from __future__ import annotations

import json
import queue
import secrets
import time
from typing import Any

import zenoh
from zenoh import ext

from lirs_extensions.live.graph import (
    SUBSCRIBED,
    LiveTopic,
    Received,
    own_address,
    zenoh_attachment,
    zenoh_key,
    zenoh_token,
)
from lirs_extensions.live.options import LiveOptions
from lirs_wct.errors import ConfigError

PATIENCE = 2.0
"""Seconds that a router has to answer."""


class ZenohNode:
    """Publishers and subscriptions of our node in a Zenoh network (see `Middleware`).

    Our session is the router that ROS nodes connect to. If a router runs already, it is a client of that:
    routers hide peers from each other that do not know them.

    Attributes:
        role: `router`, or `client` of a running router.
    """

    def __init__(self, options: LiveOptions, topics: tuple[LiveTopic, ...]) -> None:
        zenoh.init_log_from_env_or("off")
        self._session, self.role = _open(options)
        self._arrived: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._tokens: list[Any] = []
        self._domain, self._ros = options.domain, options.ros
        self._token()
        self._publishers = {topic.name: self._publisher(topic) for topic in topics}
        self._gids = {topic.name: secrets.token_bytes(16) for topic in topics}
        self._sent = dict.fromkeys(self._publishers, 0)
        self._subscriptions = [self._subscription(topic) for topic in SUBSCRIBED]

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        """Send a message with rmw_zenoh's attachment."""
        self._sent[topic] += 1
        attachment = zenoh_attachment(self._sent[topic], time.time_ns(), self._gids[topic])
        self._publishers[topic].put(bytes(message), attachment=attachment)

    def receive(self, seconds: float = 0.0) -> list[Received]:
        """Return new messages. Wait for the first one at most so long."""
        found = []
        try:
            if seconds > 0.0:
                found.append(self._arrived.get(timeout=seconds))
            while True:
                found.append(self._arrived.get_nowait())
        except queue.Empty:
            return found

    def subscribers(self, topic: str) -> int:
        """Return 1 if a topic has subscribers, else 0."""
        publisher = self._publishers.get(topic)
        return 0 if publisher is None else int(publisher.matching_status.matching)

    def publishers(self) -> int:
        """Return 1: the number is unknown."""
        return 1

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def _token(self, topic: LiveTopic | None = None, kind: str = "NN") -> None:
        token = zenoh_token(str(self._session.zid()), len(self._tokens), self._domain, self._ros, topic, kind)
        self._tokens.append(self._session.liveliness().declare_token(token))

    def _publisher(self, topic: LiveTopic) -> Any:
        self._token(topic, "MP")
        key = zenoh_key(topic, self._domain, self._ros)
        quality: Any = {
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "reliability": zenoh.Reliability.RELIABLE,
        }
        if not topic.durable:
            return self._session.declare_publisher(key, **quality)
        return ext.declare_advanced_publisher(
            self._session,
            key,
            cache=ext.CacheConfig(max_samples=topic.depth),
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
            publisher_detection=True,
            **quality,
        )

    def _subscription(self, topic: LiveTopic) -> Any:
        self._token(topic, "MS")
        return self._session.declare_subscriber(
            zenoh_key(topic, self._domain, self._ros),
            lambda sample: self._arrived.put(Received(topic, sample.payload.to_bytes())),
            allowed_origin=zenoh.Locality.REMOTE,
        )


def _open(options: LiveOptions) -> tuple[Any, str]:
    """Return a session as router, or as client of a running one, and its role."""
    endpoint = f"tcp/{own_address(options.host)}:{options.port}"
    for role, link in (("router", "listen"), ("client", "connect")):
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps(role))
        config.insert_json5(f"{link}/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/unicast/open_timeout", f"{1e3 * PATIENCE:.0f}")
        try:
            return zenoh.open(config), role
        except zenoh.ZError:
            continue
    raise ConfigError(f"{endpoint}: in use by a program that is no Zenoh router; choose another --port")

"""A ROS 2 node over DDS, by Eclipse Cyclone DDS's Python package."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype

from lirs_extensions.live.graph import (
    DISCOVERY_TOPIC,
    DISCOVERY_TYPE,
    ENCLAVE,
    SUBSCRIBED,
    LiveTopic,
    Received,
    dds_type,
    discovery_message,
    own_address,
    typestore,
    user_data,
)
from lirs_extensions.live.options import Distribution, LiveOptions
from lirs_wct.errors import ConfigError

LOCKSTEP_WAIT, REALTIME_WAIT = 10.0, 0.1
"""Seconds for which a message waits for a slow reliable subscriber, with lockstep and in real time."""
CONFIG = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="{host}"/></Interfaces>
    <AllowMulticast>{multicast}</AllowMulticast>
    <MaxMessageSize>65500B</MaxMessageSize>
  </General>
  <Discovery>
    <SPDPInterval>1s</SPDPInterval>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="{host}"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""
"""Configuration of a domain. Loopback needs no multicast: 33 participants' ports are tried each second."""
ANY = SampleState.Any | ViewState.Any | InstanceState.Any


class DdsNode:
    """Publishers and subscriptions of our node in a domain (see `Middleware`)."""

    def __init__(self, options: LiveOptions, topics: tuple[LiveTopic, ...]) -> None:
        self._ros, self._warned = options.ros, set[str]()
        self._patience = LOCKSTEP_WAIT if options.lockstep else REALTIME_WAIT
        host = own_address(options.host)
        config = CONFIG.format(host=host, multicast="false" if options.host is None else "spdp")
        try:
            self._domain = Domain(options.domain, config)
            self._participant = DomainParticipant(options.domain, Qos(Policy.Userdata(ENCLAVE)))
        except DDSException as error:
            raise ConfigError(f"--domain {options.domain} cannot be joined from {host}: {error}") from error
        self._writers = {topic.name: self._writer(f"rt{topic.name}", topic) for topic in topics}
        self._readers = [(topic, self._reader(topic)) for topic in SUBSCRIBED]
        self._waiting = WaitSet(self._participant)
        self._conditions = [ReadCondition(reader, ANY) for _, reader in self._readers]
        for condition in self._conditions:
            self._waiting.attach(condition)
        # `ros2 node list` reads our node on this topic.
        discovery = LiveTopic(DISCOVERY_TOPIC, DISCOVERY_TYPE, 1, durable=True)
        self._graph = self._writer(DISCOVERY_TOPIC, discovery)
        readers = [reader.guid.bytes for _, reader in self._readers]
        writers = [writer.guid.bytes for writer in self._writers.values()]
        write_raw(self._graph, discovery_message(self._participant.guid.bytes, readers, writers, self._ros))

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        """Send a message; drop it with a warning if a reliable subscriber does not take it in time."""
        try:
            write_raw(self._writers[topic], bytes(message))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            if topic not in self._warned:
                self._warned.add(topic)
                warnings.warn(f"{topic}: a subscriber hangs, messages are dropped", stacklevel=2)

    def receive(self, seconds: float = 0.0) -> list[Received]:
        """Return new messages. Wait for the first one at most so long."""
        if seconds > 0.0:
            self._waiting.wait(duration(nanoseconds=round(seconds * 1e9)))
        return [
            Received(topic, sample.cdr)
            for topic, reader in self._readers
            for sample in reader.take(topic.depth)
            if hasattr(sample, "cdr")  # an unregistered writer's sample has no data
        ]

    def subscribers(self, topic: str) -> int:
        """Return the present number of subscribers of a topic; 0 if it is not published."""
        writer = self._writers.get(topic)
        return 0 if writer is None else int(writer.get_publication_matched_status().current_count)

    def publishers(self) -> int:
        """Return the present number of publishers on our subscriptions."""
        counts = (reader.get_subscription_matched_status().current_count for _, reader in self._readers)
        return int(sum(counts))

    def close(self) -> None:
        """Leave the domain."""
        for entity in (*self._conditions, self._waiting, self._participant, self._domain):
            entity._delete(entity._ref)

    def _writer(self, name: str, topic: LiveTopic) -> Any:
        return DataWriter(self._participant, self._topic(name, topic.kind), self._quality(topic))

    def _reader(self, topic: LiveTopic) -> Any:
        own_ones = Policy.IgnoreLocal.Participant
        quality = Qos(own_ones, base=self._quality(topic))
        return DataReader(self._participant, self._topic(f"rt{topic.name}", topic.kind), quality)

    def _topic(self, name: str, kind: str) -> Any:
        return DdsTopic(self._participant, name, raw_type(kind, self._ros))

    def _quality(self, topic: LiveTopic) -> Any:
        return Qos(
            Policy.Reliability.Reliable(duration(seconds=self._patience)),
            Policy.Durability.TransientLocal if topic.durable else Policy.Durability.Volatile,
            Policy.History.KeepLast(topic.depth),
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
            Policy.Userdata(user_data(topic.kind, self._ros)),
        )


def write_raw(writer: Any, message: bytes) -> None:
    """Send CDR bytes on a writer of a `raw_type`."""
    sample = writer.data_type.__new__(writer.data_type)
    sample.cdr = message
    writer.write(sample)


@cache
def raw_type(kind: str, distribution: Distribution) -> Any:
    """Return a type whose samples hold CDR bytes and are not decoded.

    Its fields are declared all the same: DDS compares the types of both sides, and checks each message.
    """
    raw = _struct(kind, distribution)

    def deserialize(data: bytes, **_: Any) -> Any:
        sample = raw.__new__(raw)
        sample.cdr = bytes(data)
        return sample

    raw.serialize = lambda sample, **_: sample.cdr
    raw.deserialize = staticmethod(deserialize)
    return raw


@cache
def _struct(kind: str, distribution: Distribution) -> Any:
    fields = typestore(distribution).fielddefs[kind][1]
    return make_idl_struct(
        f"{kind.rpartition('/')[2]}_",
        dds_type(kind),
        {name: _field(node, value, distribution) for name, (node, value) in fields},
    )


def _field(node: Nodetype, value: Any, distribution: Distribution) -> Any:
    """Return the IDL type of a field, as rosbags describes it."""
    if node == Nodetype.NAME:
        return _struct(value, distribution)
    if node == Nodetype.BASE:
        name, longest = value
        if name == "string":
            return types.bounded_str[longest] if longest else str
        plain = {"bool": bool, "char": types.uint8, "byte": types.uint8}
        return plain[name] if name in plain else getattr(types, name)
    (inner, inside), length = value
    element = _field(inner, inside, distribution)
    if node == Nodetype.ARRAY:
        return types.array[element, length]
    return types.sequence[element, length] if length else types.sequence[element]

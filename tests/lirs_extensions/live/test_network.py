"""Live drives over DDS and Zenoh, with clients in other processes."""

import os
import queue
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh
from zenoh import ext

from lirs_extensions.live import run as live_run
from lirs_extensions.live.dds import DdsNode, raw_type, write_raw
from lirs_extensions.live.graph import CYCLONE_LOOPBACK, PUBLISHED, TWIST, type_hash, zenoh_key
from lirs_extensions.live.options import LiveOptions
from lirs_extensions.live.run import live
from lirs_extensions.live.zenoh_node import ZenohNode
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run as run_offline
from lirs_wct import ConfigError
from tests.kit import SMALL
from tests.lirs_extensions.live import client_process, fake_network as net

ROOT = Path(__file__).resolve().parents[3]
LIMIT = 60.0
"""Wall seconds that a client on a loaded machine may take for one answer."""


@contextmanager
def process(*command, **given):
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(ROOT), str(ROOT / "envs")]))
    started = subprocess.Popen([*map(str, command)], env=environment, text=True, **given)
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def client(middleware, place, *mode, **given):
    return process(sys.executable, client_process.__file__, middleware, place, *mode, **given)


def lockstep(domain, **given):
    return LiveOptions(lockstep=True, limit=LIMIT, domain=domain, **given)


CYCLONE = """
import sys, time
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from lirs_extensions.live.dds import raw_type
participant = DomainParticipant(int(sys.argv[1]))
scan = Topic(participant, "rt/scan", raw_type("sensor_msgs/msg/LaserScan", "jazzy"))
reader = DataReader(participant, scan)
time.sleep(60)
"""


@pytest.mark.slow
def test_a_cyclone_client_is_on_loopback_by_the_setting_that_we_print(domain, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", CYCLONE_LOOPBACK)
    with process(sys.executable, "-c", CYCLONE, domain):
        node = DdsNode(LiveOptions(domain=domain), PUBLISHED)
        try:
            end = time.perf_counter() + LIMIT
            while not node.subscribers("/scan"):
                assert time.perf_counter() < end, "no subscriber of /scan"
                time.sleep(0.05)
        finally:
            node.close()


def drive(options, out=None, **run):
    given = {"mapper": options.client, "driver": "client", **run}
    (result,) = live(RunConfig(source="simple", build=SMALL, **given), options, out=out)
    return result


@pytest.mark.slow
def test_the_example_drives_a_robot(domain, tmp_path):
    with process(sys.executable, ROOT / "examples/live_driver.py", domain) as driver:
        result = drive(lockstep(domain), tmp_path, seconds=2.0)
        assert driver.wait(30.0) == 0  # it ends with the drive
    assert (result.bridge.answered, result.bridge.published) == (51, 51)
    assert result.run.record.trajectory["length"] > 0.2
    assert (result.run.folder / "record.json").exists()


@pytest.mark.slow
def test_hector_as_client_gives_the_offline_run(domain):
    seconds = 1.0
    offline = run_offline(RunConfig(source="simple", build=SMALL, mapper="hector", seconds=seconds))
    with client("dds", domain, "hector"):
        result = drive(lockstep(domain, answer="tf"), seconds=seconds, driver="tour")
    expected, found = offline.log.trajectories()[1], result.run.log.trajectories()[1]
    assert len(found) == len(expected) == 26
    assert np.abs(found.positions - expected.positions).max() < 1e-6
    assert np.abs(found.quaternions - expected.quaternions).max() < 1e-6
    assert result.run.record.trajectory["length"] == offline.record.trajectory["length"]
    assert result.run.maps.scores["f1"] == pytest.approx(offline.maps.scores["f1"], abs=1e-6)


@pytest.mark.slow
def test_a_slow_client_gets_the_same_bytes(domain, monkeypatch):
    sent = []

    class Recorded(DdsNode):
        def publish(self, topic, message):
            sent[-1].append((topic, bytes(message)))
            super().publish(topic, message)

    monkeypatch.setattr(live_run, "open_middleware", Recorded)
    for delay in (0.0, 0.01, 0.2):
        sent.append([])
        with client("dds", domain, "forward", delay):
            result = drive(lockstep(domain), seconds=0.4)
        assert result.bridge.answered == 11
    assert sent[0] == sent[1] == sent[2]
    assert len(sent[0]) > 11


def test_a_node_announces_itself_as_ros_nodes_do(domain):
    """What `ros2 node list` and `ros2 topic info -v` read: rmw_dds_common's discovery topic and user data."""
    from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
    from cyclonedds.core import Policy

    node = DdsNode(LiveOptions(domain=domain), live_run.PUBLISHED)
    try:
        endpoints = BuiltinDataReader(node._participant, BuiltinTopicDcpsPublication).take(100)
        types = {found.topic_name: found.type_name for found in endpoints}
        data = {found.topic_name: found.qos[Policy.Userdata].data for found in endpoints}
        assert types["rt/scan"] == "sensor_msgs::msg::dds_::LaserScan_"
        assert types["ros_discovery_info"] == "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
        assert data["rt/scan"] == f"typehash={type_hash('sensor_msgs/msg/LaserScan', 'jazzy')};".encode()
        assert node._participant.get_qos()[Policy.Userdata].data == b"enclave=/;"
    finally:
        node.close()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.slow
def test_a_zenoh_peer_drives_and_sees_the_tokens():
    port = free_port()
    options = lockstep(0, middleware="zenoh", port=port)
    with client("zenoh", port, "forward", "0", stdout=subprocess.PIPE) as peer:
        result = drive(options, seconds=0.4)
        attachment, *tokens = peer.stdout.readline().split()
    assert result.bridge.answered == result.bridge.published == 11
    sequence, _, length, gid = struct.unpack("<qqB16s", bytes.fromhex(attachment))
    assert (sequence, length) == (1, 16)
    assert gid != bytes(16)
    assert any(token.endswith("/NN/%/%/lirs_wct") for token in tokens)
    assert sum("/MP/" in token for token in tokens) == 8
    assert sum("/MS/" in token for token in tokens) == 7


def test_a_second_zenoh_node_is_a_client_of_the_first():
    """Two peers would not see each other through a router (rmw_zenoh's issue 929); a client sees all."""
    options = LiveOptions(middleware="zenoh", port=free_port())
    first = ZenohNode(options, PUBLISHED)
    second = ZenohNode(options, PUBLISHED)
    try:
        assert (first.role, second.role) == ("router", "client")
        for sender, receiver in ((second, first), (first, second)):
            end = time.monotonic() + 30.0
            while not sender.subscribers("/tf") and time.monotonic() < end:
                time.sleep(0.01)
            sender.publish("/tf", b"abc")
            (message,) = receiver.receive(30.0)
            assert (message.topic.name, message.cdr) == ("/tf", b"abc")
    finally:
        second.close()
        first.close()


def test_a_port_of_another_program_is_one_line():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=f"tcp/127.0.0.1:{port}: in use by a program"):
            ZenohNode(LiveOptions(middleware="zenoh", port=port), PUBLISHED)


@pytest.mark.parametrize("node", [DdsNode, ZenohNode])
@pytest.mark.parametrize(
    ("host", "message"),
    [
        ("192.0.2.77", "192\\.0\\.2\\.77: no address of this machine"),
        (70 * "a", "a+: no address of this machine: no name"),
        ("0.0.0.0", "needs one address"),
        ("", "needs one address"),
    ],
)
def test_a_host_elsewhere_is_one_line(node, host, message):
    with pytest.raises(ConfigError, match=f"--host .*{message}"):
        node(LiveOptions(host=host), PUBLISHED)


def test_both_kinds_of_commands_arrive(domain):
    """ROS nodes publish Twist or TwistStamped under the same name."""
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    node = DdsNode(LiveOptions(domain=domain), PUBLISHED)
    other = DomainParticipant(domain)
    quality = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
    )
    plain = net.received(net.topic("/cmd_vel", TWIST), net.twist(0.3, 0.1))
    try:
        for sent in (plain, net.stamped(7, 0.5)):
            topic = Topic(other, "rt/cmd_vel", raw_type(sent.topic.kind, "jazzy"))
            writer = DataWriter(other, topic, quality)
            while not writer.get_publication_matched_status().current_count:
                time.sleep(0.01)
            write_raw(writer, sent.cdr)
            assert node.receive(30.0) == [sent]
    finally:
        node.close()


def test_a_late_zenoh_subscriber_gets_the_static_frames():
    """As rmw_zenoh subscribes to transient-local topics: with a query of the publisher's history."""
    node = ZenohNode(LiveOptions(middleware="zenoh", port=(port := free_port())), PUBLISHED)
    peer = None
    try:
        node.publish("/tf_static", b"static")
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        peer = zenoh.open(config)
        key = zenoh_key(client_process.published("/tf_static"), 0, "jazzy")
        arrived = queue.SimpleQueue()
        history = ext.HistoryConfig(detect_late_publishers=True)
        _held = ext.declare_advanced_subscriber(peer, key, arrived.put, history=history)
        assert arrived.get(timeout=30.0).payload.to_bytes() == b"static"
    finally:
        if peer is not None:
            peer.close()
        node.close()

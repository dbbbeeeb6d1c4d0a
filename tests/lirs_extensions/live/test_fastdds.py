"""Clients over Fast DDS in C++, the default middleware of Humble and Jazzy."""

import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.live import run as live_run
from lirs_extensions.live.dds import DdsNode
from lirs_extensions.live.graph import DISCOVERY_TYPE, type_hash, typestore
from lirs_extensions.live.options import LiveOptions
from lirs_extensions.live.run import live
from lirs_validation.config import RunConfig

SOURCE = Path(__file__).with_name("fastdds_client.cpp")
HEADER = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        shutil.which("g++") is None or not HEADER.exists(), reason="needs g++ and Debian's libfastrtps-dev"
    ),
]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    built = tmp_path_factory.mktemp("fastdds") / "client"
    libraries = ["-lfastrtps", "-lfastcdr", "-lpthread"]
    subprocess.run(["g++", "-std=c++14", SOURCE, "-o", built, *libraries], check=True, timeout=300)
    return built


def drive(program, domain, folder, monkeypatch, scans, clouds, *, seconds, speed=0.3, best_effort=(), **run):
    """Return the result, the published bytes, the received ones by kind, and the client's output."""
    sent = {"s": [], "c": []}

    class Recorded(DdsNode):
        def publish(self, topic, message):
            kind = {"/scan": "s", "/points": "c"}.get(topic)
            if kind:
                sent[kind].append(bytes(message))
            super().publish(topic, message)

    monkeypatch.setattr(live_run, "open_middleware", Recorded)
    options = LiveOptions(lockstep=not best_effort, domain=domain, limit=60.0 if not best_effort else 5.0)
    command = [program, domain, scans, clouds, speed, folder / "received", *best_effort]
    client = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, text=True)
    try:
        config = {"driver": "client", "mapper": "client", "seconds": seconds, **run}
        (result,) = live(RunConfig(source="simple", **config), options)
        output = client.communicate(timeout=60)[0]
    finally:
        client.kill()
    return result, sent, read(folder / "received"), output


def read(path):
    found, data, at = {"s": [], "c": [], "d": []}, path.read_bytes(), 0
    while at < len(data):
        kind, size = struct.unpack_from("<cI", data, at)
        found[kind.decode()].append(data[at + 5 : at + 5 + size])
        at += 5 + size
    return found


def same(received, sent):
    """Whether CDR bytes are equal; DDS pads messages to 4 bytes, which the header's last byte counts."""
    padding = len(received) - len(sent)
    return 0 <= padding < 4 and received[4 : len(sent)] == sent[4:] and received[:3] == sent[:3]


def test_1000_scans_arrive_bit_for_bit_and_the_client_drives(program, domain, tmp_path, monkeypatch):
    period = 0.04
    result, sent, received, output = drive(
        program, domain, tmp_path, monkeypatch, 1000, 0, seconds=999 * period
    )
    assert len(sent["s"]) == len(received["s"]) == 1000
    assert all(map(same, received["s"], sent["s"]))
    assert result.bridge.answered == 1000
    assert result.run.log.commands[-1].v == pytest.approx(0.3)
    assert result.run.record.trajectory["length"] > 1.0
    lines = dict(line.split(" ", 1) for line in output.splitlines())
    kind = "sensor_msgs/msg/LaserScan"
    assert lines["rt/scan"] == f"sensor_msgs::msg::dds_::LaserScan_ typehash={type_hash(kind, 'jazzy')};"
    (graph,) = received["d"]
    node = typestore("jazzy").deserialize_cdr(graph, DISCOVERY_TYPE).node_entities_info_seq[0]
    assert (node.node_namespace, node.node_name, len(node.writer_gid_seq)) == ("/", "lirs_wct", 8)
    assert len({gid.data.tobytes() for gid in node.writer_gid_seq}) == 8


def test_1000_clouds_arrive_bit_for_bit(program, domain, tmp_path, monkeypatch):
    _, sent, received, _ = drive(
        program, domain, tmp_path, monkeypatch, 1000, 1000, seconds=99.9, speed=0.0, lidar="vlp16"
    )
    assert len(sent["c"]) == len(received["c"]) == 1000
    assert np.median([len(message) for message in sent["c"]]) > 500_000
    assert all(map(same, received["c"], sent["c"]))
    assert all(map(same, received["s"], sent["s"]))


def test_50_clients_that_are_killed_do_no_harm(program, domain, tmp_path):
    """The 51st drives the robot, on a slow machine too: it has 30 s to be discovered."""
    options = LiveOptions(domain=domain, rate=1.0)
    config = RunConfig(source="simple", driver="client", mapper="client", seconds=45.0, lidar="vlp16")
    command = [program, domain, 10**6, 10**6, 0.3, tmp_path / "received"]
    script = 'for k in $(seq 50); do timeout -s KILL 0.$((k % 5 + 1)) "$@"; done; exec "$@"'
    clients = subprocess.Popen(
        ["bash", "-c", script, "-", *map(str, command)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        (result,) = live(config, options)
    finally:
        clients.kill()
    assert result.run.record.status == "ok"
    assert result.bridge.published == 451
    assert result.bridge.client.messages > 0
    assert result.run.record.trajectory["length"] > 0.3

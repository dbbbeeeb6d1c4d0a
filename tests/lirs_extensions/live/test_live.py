"""Live drives without a network: messages, answers, new starts, records."""

import functools
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lirs_extensions.live import run as live_run
from lirs_extensions.live.graph import CYCLONE_LOOPBACK, PUBLISHED
from lirs_extensions.live.options import LiveOptions
from lirs_extensions.live.run import live
from lirs_validation.config import RunConfig
from lirs_validation.record.run_record import read_record, schema_error
from lirs_wct import ConfigError
from tests.kit import SMALL
from tests.lirs_extensions.live import fake_network as net

LOCKSTEP = LiveOptions(lockstep=True)
pytestmark = pytest.mark.usefixtures("plain_pictures")


@pytest.fixture(autouse=True)
def one_world(monkeypatch):
    """Build the world of these tests once."""
    monkeypatch.setattr(live_run, "build_scenario", lambda config: replace(_scenario(), config=config))


@functools.cache
def _scenario():
    from lirs_validation.experiment.scenario import build_scenario

    return build_scenario(RunConfig(source="simple", build=SMALL))


def drive(network, monkeypatch, options=LOCKSTEP, out=None, **run):
    monkeypatch.setattr(live_run, "open_middleware", lambda *_: network)
    given = {"seconds": 0.4, "mapper": options.client, "driver": "client", **run}
    return list(live(RunConfig(source="simple", **given), options, out=out))


def forward(topic, message):
    """Drive ahead, a little faster with each scan."""
    stamp = net.stamp_of(message)
    return [net.stamped(stamp, 0.5 + 1e-10 * stamp)] if topic == "/scan" else []


def test_all_messages_are_rosbags_cdr(monkeypatch):
    network = net.FakeNetwork(forward)
    drive(network, monkeypatch, mapper="hector", lidar="vlp16", seconds=0.1)
    kinds = {topic.name: topic.kind for topic in PUBLISHED}
    assert {topic for topic, _ in network.sent} == set(kinds)
    for topic, message in network.sent:
        decoded = net.STORE.deserialize_cdr(message, kinds[topic])
        assert bytes(net.STORE.serialize_cdr(decoded, kinds[topic])) == message, topic


def test_the_client_drives_and_the_record_counts_its_answers(monkeypatch, tmp_path):
    (result,) = drive(net.FakeNetwork(forward), monkeypatch, out=tmp_path, seconds=2.0)
    assert (result.bridge.published, result.bridge.answered, result.bridge.late) == (51, 51, 0)
    record = read_record(result.run.folder)
    assert record["config"]["mapper"] == "client"
    assert record["config"]["driver"] == "client"
    assert record["mapper"]["used"] == record["mapper"]["received"] == 51
    assert record["trajectory"]["length"] > 0.6
    # Without map -> odom the client's path is the odometry.
    assert record["trajectory"]["ate_rmse"] == pytest.approx(record["trajectory"]["odometry_ate_rmse"])
    assert (result.run.folder / "map.yaml").exists()


def test_a_client_that_never_answers_is_skipped_and_counted(monkeypatch):
    options = LiveOptions(lockstep=True, limit=0.01)
    with pytest.warns(UserWarning, match=r"no answer within 0.01 s \(option limit\): scans are skipped"):
        (result,) = drive(net.FakeNetwork(), monkeypatch, options)
    assert result.run.record.mapper["skipped"] == {"no answer within the limit": 11}
    assert result.run.record.trajectory["length"] < 0.01


def test_late_answers_are_counted(monkeypatch):
    """The answer to a scan comes after the next scan."""
    last = []

    def client(topic, message):
        if topic != "/scan":
            return []
        last.append(net.stamp_of(message))
        return [net.stamped(last[-2], 0.5)] if len(last) > 1 else []

    (result,) = drive(net.FakeNetwork(client), monkeypatch, LiveOptions(rate=1000.0))
    assert (result.bridge.published, result.bridge.answered, result.bridge.late) == (11, 0, 10)


def test_poses_and_map_of_the_client_are_evaluated(monkeypatch):
    """A client that publishes the truth as map -> odom, and one free cell under the robot."""

    def client(topic, message):
        kinds = {found.name: found.kind for found in PUBLISHED}
        decoded = net.STORE.deserialize_cdr(message, kinds[topic])
        if topic == "/odom":
            client.odometry = decoded.pose.pose
        if topic != "/ground_truth":
            return []
        stamp, truth = net.stamp_of(message), decoded.pose
        yaw, drift = (2 * np.arctan2(p.orientation.z, p.orientation.w) for p in (truth, client.odometry))
        turn = float(yaw - drift)
        x, y = client.odometry.position.x, client.odometry.position.y
        moved = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
        frame = net.frame(stamp, truth.position.x - moved[0], truth.position.y - moved[1], turn)
        claimed = net.start(0.0, 0.0, 0.0, name="/pose", variance=1e-6)
        grid = net.grid([[0]], 0.5, (0.0, 0.0, 0.0))
        return [claimed, grid, net.frames(frame), net.stamped(stamp, 0.5, 0.3)]

    options = LiveOptions(lockstep=True, answer="cmd_vel")
    (result,) = drive(net.FakeNetwork(client), monkeypatch, options, seconds=3.0)
    errors = result.run.record.trajectory
    assert errors["odometry_ate_rmse"] > 1e-3
    assert errors["ate_rmse"] < 1e-3  # the roll and pitch of the truth are not its
    assert errors["inside_95"] > 0.9
    assert result.run.maps.built.known.sum() == 1


def test_a_reset_begins_a_new_drive_at_the_same_start(monkeypatch, tmp_path):
    asked = []

    def client(topic, message):
        if topic == "/scan" and net.stamp_of(message) > 2e8 and not asked:
            asked.append(1)
            return [net.received(net.topic("/reset"), net.TYPES["std_msgs/msg/Empty"](0))]
        return forward(topic, message)

    network = net.FakeNetwork(client)
    first, second = drive(network, monkeypatch, out=tmp_path, seconds=1.0)
    assert "new start" in first.run.record.reason
    assert second.run.folder.name == f"{first.run.folder.name}-2"
    assert first.run.log.start == second.run.log.start
    driven = [len(found.run.log.tick_seconds) for found in (first, second)]
    assert sum(driven) == 25
    scans = [message for topic, message in network.sent if topic == "/scan"]
    assert scans[0] == scans[driven[0] + 1]  # same seed, same bytes
    assert Counter(topic for topic, _ in network.sent)["/tf_static"] == 2


def test_an_initial_pose_begins_a_new_drive_there(monkeypatch):
    asked = []

    def client(topic, message):
        if topic == "/scan" and not asked:
            asked.append(1)
            return [net.start(0.4, -0.3, 0.5)]
        if topic == "/ground_truth" and asked:
            asked.append(net.STORE.deserialize_cdr(message, "geometry_msgs/msg/PoseStamped").pose.position)
        return forward(topic, message)

    first, second = drive(net.FakeNetwork(client), monkeypatch, seconds=1.0)
    expected = first.run.log.start @ type(first.run.log.start)(0.4, -0.3, 0.5)
    start = second.run.log.start
    assert (start.x, start.y, start.yaw) == pytest.approx((expected.x, expected.y, expected.yaw))
    assert (asked[3].x, asked[3].y) == pytest.approx((0.4, -0.3), abs=0.02)  # as /map sees it
    assert second.run.record.trajectory["ate_rmse_unaligned"] < 0.1


def test_a_start_where_the_robot_cannot_stand_is_refused_in_one_line(monkeypatch):
    asked = []

    def client(topic, message):
        if topic == "/scan" and not asked:
            asked.append(1)
            return [net.start(1e6, 0.0, 0.0)]
        return forward(topic, message)

    with pytest.warns(UserWarning, match="/initialpose: husky cannot stand"):
        first, second = drive(net.FakeNetwork(client), monkeypatch)
    assert first.run.log.start == second.run.log.start


def test_ctrl_c_ends_a_drive_and_evaluates_it(monkeypatch, tmp_path):
    def client(topic, message):
        if topic == "/scan" and net.stamp_of(message) == 4 * 10**8:
            signal.raise_signal(signal.SIGINT)
        return forward(topic, message)

    former = signal.getsignal(signal.SIGINT)
    (result,) = drive(net.FakeNetwork(client), monkeypatch, out=tmp_path, seconds=100.0)
    assert signal.getsignal(signal.SIGINT) is former
    assert result.run.record.reason == "ended by Ctrl-C at 0.4 s"
    assert schema_error(read_record(result.run.folder)) is None


@pytest.mark.parametrize(
    ("run", "options", "message"),
    [
        ({"mapper": "hectr"}, {}, "unknown mapper 'hectr'"),
        ({"mapper": "kiss-icp"}, {}, "live publishes the map of hector"),
        ({"driver": "frontier"}, {}, "give --mapper"),
        ({"driver": "pretrained", "reversing": 0.5}, {}, "reversing must be 0"),
    ],
)
def test_drives_that_cannot_be_are_refused(monkeypatch, run, options, message):
    with pytest.raises(ConfigError, match=message):
        drive(net.FakeNetwork(), monkeypatch, LiveOptions(**options), **run)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"every": 0, "lockstep": True}, "every must be at least 1"),
        ({"every": 2}, "the option every is for --lockstep"),
        ({"lockstep": True, "rate": 2.0}, "--rate is for drives without --lockstep"),
        ({"rate": 0.0}, "rate"),
        ({"domain": 233}, "domain"),
        ({"middleware": "udp"}, "middleware"),
        ({"ros": "iron"}, "ros"),
        ({"client": "a/b"}, "--client"),
        ({"answer": "scan"}, "answer"),
    ],
)
def test_illegal_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        LiveOptions(**options)


def test_a_missing_package_is_one_line(monkeypatch):
    monkeypatch.setattr(live_run, "find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=r"needs the package cyclonedds: pip install 'lirs-wct\[live\]'"):
        drive(net.FakeNetwork(), monkeypatch)


def test_no_client_is_one_line(monkeypatch):
    network = net.FakeNetwork()
    network.subscribers = lambda _: 0
    with pytest.raises(ConfigError, match="dds domain 0 on loopback: no subscriber of /scan") as error:
        drive(network, monkeypatch, LiveOptions(wait=0.1))
    assert f"export CYCLONEDDS_URI='{CYCLONE_LOOPBACK}'" in str(error.value)
    assert CYCLONE_LOOPBACK in (Path(__file__).parents[3] / "docs" / "howto" / "live.md").read_text()
    with pytest.raises(ConfigError, match=r"within 0\.1 s \(option wait\)$"):
        drive(network, monkeypatch, LiveOptions(wait=0.1, middleware="zenoh"))

"""The state of a client, from bytes as other programs send them."""

import math

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_extensions.live.bridge import STOPPED_AFTER, Client
from lirs_extensions.live.graph import TWIST, Received
from lirs_extensions.live.options import LiveOptions
from lirs_wct import Pose2
from tests.lirs_extensions.live import fake_network as net


def client(**options):
    return Client(LiveOptions(**options), make_robot("husky"), 0.02, Pose2())


def test_a_command_holds_within_the_robots_limits_and_ends_when_it_is_old():
    it = client()
    assert it.take([net.stamped(5, 9.0, -9.0)], 1.0) == 5
    assert (it.command(1.0).v, it.command(1.0).omega) == (1.0, -2.0)
    assert it.command(1.0 + STOPPED_AFTER + 0.01).v == 0.0
    it.take([net.received(net.topic("/cmd_vel", TWIST), net.twist(0.3, 0.1))], 2.0)
    assert (it.command(2.1).v, it.command(2.1).omega) == (0.3, 0.1)


@pytest.mark.parametrize(("answer", "tf", "command"), [("any", 7, 9), ("tf", 7, 0), ("cmd_vel", 0, 9)])
def test_only_the_chosen_message_answers(answer, tf, command):
    it = client(answer=answer)
    assert it.take([net.frames(net.frame(7, 0.0, 0.0, 0.0))], 0.0) == tf
    assert it.take([net.stamped(9, 0.1)], 0.0) == command


def test_the_transform_map_odom_moves_the_estimate_and_others_do_not():
    it = client()
    other = net.frame(4, 9.0, 9.0, 0.0, "odom", "base_link")
    it.take([net.frames(other, net.frame(3, 1.0, 2.0, math.pi / 2))], 0.0)
    T = it.estimate(Pose2(1.0, 0.0, 0.0)).to_pose2()
    assert (T.x, T.y, T.yaw) == pytest.approx((1.0, 3.0, math.pi / 2))


def test_late_transforms_count_for_their_own_scans():
    it = client()
    for k in range(3):
        it.drove(float(k + 1), Pose2(float(k), 0.0, 0.0))
    it.take([net.frames(net.frame((k + 1) * 10**9, 0.0, float(k), 0.0)) for k in range(3)], 9.0)
    found = it.trajectory()
    assert found.stamps.tolist() == [1.0, 2.0, 3.0]
    assert found.positions[:, :2].tolist() == [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]


def test_a_map_comes_in_its_frame():
    it = client()
    it.take([net.grid([[0, 100, -1], [50, 20, 70]], 0.5, (1.0, 2.0, 0.0))], 0.0)
    assert it.grid.origin == Pose2(1.0, 2.0, 0.0)
    assert it.grid.occupied.tolist() == [[False, True, False], [False, False, True]]
    assert it.grid.free.tolist() == [[True, False, False], [False, True, False]]
    assert it.grid.known.sum() == 5


def test_a_pose_tells_its_covariance_alone():
    it = client()
    assert it.covariance is None
    it.take([net.start(5.0, 5.0, 1.0, name="/pose", variance=0.3)], 0.0)
    assert np.array_equal(it.covariance, 0.3 * np.eye(3))
    assert (it.start, it.reset, it.estimate(Pose2()).x) == (None, False, 0.0)
    with pytest.warns(UserWarning, match="/pose: a message is damaged and ignored: covariance must"):
        it.take([net.start(5.0, 5.0, 1.0, name="/pose", variance=-1.0)], 0.0)
    assert np.array_equal(it.covariance, 0.3 * np.eye(3))
    it.take([net.start(5.0, 5.0, 1.0, name="/pose")], 0.0)  # in ROS, zeros are unknown
    assert it.covariance is None


def test_damaged_messages_warn_once_and_change_nothing():
    it = client()
    command = net.topic("/cmd_vel", TWIST)
    whole = net.received(command, net.twist(0.3, 0.1)).cdr
    with pytest.warns(UserWarning, match="/cmd_vel: a message is damaged") as warned:
        it.take(
            [
                Received(command, whole[:9]),
                Received(command, b""),
                net.received(command, net.twist(math.nan, 0.1)),
            ],
            0.0,
        )
    assert len(warned) == 1
    assert it.command(0.0).v == 0.0
    wrong = net.grid([[0, 0]], 0.5, (0.0, 0.0, 0.0))
    cdr = bytearray(wrong.cdr)
    width = cdr.index(np.uint32(2).tobytes() + np.uint32(1).tobytes(), 20)
    cdr[width] = 3
    with pytest.warns(UserWarning, match="3 x 1 cells, but 2 values"):
        it.take([Received(wrong.topic, bytes(cdr))], 0.0)
    assert it.grid is None

"""Drive a robot of `lirs-wct live` from another process: ahead, and away from what is near.

    lirs-wct live simple --lockstep --mapper hector --seconds 60 -o out/ &
    python examples/live_driver.py

It speaks DDS as ROS 2 nodes do, with the package cyclonedds alone. With ROS 2, a node of rclpy or rclcpp
with the same topics takes its place.
"""

import math
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""
NEAR, LOOK = 1.0, 0.1
"""Meters below which the robot turns; seconds between two looks for `lirs-wct live`."""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """ROS time."""

    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """Stamp and frame."""

    stamp: Time
    frame_id: str


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    """Planar scan."""

    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """Vector."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    """Velocity: m/s and rad/s."""

    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    """Command for the scan with the same stamp."""

    header: Header
    twist: Twist


def command(scan: LaserScan) -> Twist:
    """Drive ahead; turn to the freer side if something is near in front."""
    half = len(scan.ranges) // 2
    sides = scan.ranges[half // 2 : half], scan.ranges[half : half + half // 2]
    right, left = (min((r for r in side if math.isfinite(r)), default=scan.range_max) for side in sides)
    if min(right, left) > NEAR:
        return Twist(Vector3(x=0.5), Vector3())
    return Twist(Vector3(), Vector3(z=0.8 if left > right else -0.8))


def main(number: int) -> None:
    """Answer every scan of the domain with a command, until `live` ends."""
    _domain = Domain(number, LOOPBACK)
    participant = DomainParticipant(number)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    plain_cdr = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
    quality = Qos(plain_cdr, base=reliable)
    commands = DataWriter(participant, Topic(participant, "rt/cmd_vel", TwistStamped), quality)
    print(f"domain {number}: waiting for lirs-wct live")
    while not commands.get_publication_matched_status().current_count:
        time.sleep(LOOK)
    scans = DataReader(participant, Topic(participant, "rt/scan", LaserScan), quality)
    anything = ReadCondition(scans, SampleState.Any | ViewState.Any | InstanceState.Alive)
    waiting = WaitSet(participant)
    waiting.attach(anything)
    while commands.get_publication_matched_status().current_count:
        waiting.wait(duration(seconds=LOOK))
        for scan in scans.take(10, condition=anything):
            commands.write(TwistStamped(Header(scan.header.stamp, "base_link"), command(scan)))


if __name__ == "__main__":
    try:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 0)
    except DDSException as error:
        sys.exit(str(error))

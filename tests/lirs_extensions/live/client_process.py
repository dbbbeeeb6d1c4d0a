"""A client in its own process: client_process.py dds|zenoh DOMAIN-OR-PORT forward SECONDS | hector

`forward` drives ahead, `SECONDS` after each scan; `hector` maps, and publishes map -> odom and /map.
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from lirs_extensions.live.graph import PUBLISHED, SUBSCRIBED, TWIST_STAMPED, LiveTopic, typestore, zenoh_key
from lirs_wct import Imu, LaserScan
from lirs_wct.formats.rosbag.frames import pose_of, seconds
from lirs_wct.formats.rosbag.messages import MAPPED, occupancy_grid, transforms
from lirs_wct.formats.rosbag.sensor_messages import beams_of, geometry
from lirs_wct.geometry.pose import Pose3
from tests.lirs_extensions.live import fake_network as net

QUIET = 60.0


class DdsClient:
    def __init__(self, domain: int, reads: list[LiveTopic], writes: list[LiveTopic]) -> None:
        from cyclonedds.domain import Domain, DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.qos import Policy, Qos
        from cyclonedds.sub import DataReader
        from cyclonedds.topic import Topic as DdsTopic
        from cyclonedds.util import duration

        from lirs_extensions.live.dds import CONFIG, raw_type

        self.domain = Domain(domain, CONFIG.format(host="127.0.0.1", multicast="false"))
        self.participant = DomainParticipant(domain)

        def quality(topic):
            durable = Policy.Durability.TransientLocal if topic.durable else Policy.Durability.Volatile
            plain = Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
            reliable = Policy.Reliability.Reliable(duration(seconds=1))
            return Qos(reliable, durable, plain, Policy.History.KeepLast(100))

        def made(topic):
            return DdsTopic(self.participant, f"rt{topic.name}", raw_type(topic.kind, "jazzy"))

        self.writers = {t.name: DataWriter(self.participant, made(t), quality(t)) for t in writes}
        while not all(w.get_publication_matched_status().current_count for w in self.writers.values()):
            time.sleep(0.01)
        self.readers = [(t, DataReader(self.participant, made(t), quality(t))) for t in reads]

    def receive(self):
        found = [(topic, sample) for topic, reader in self.readers for sample in reader.take(100)]
        return [(topic, sample.cdr) for topic, sample in found if hasattr(sample, "cdr")]

    def publish(self, topic, message):
        from lirs_extensions.live.dds import write_raw

        write_raw(self.writers[topic], bytes(message))


class ZenohClient:
    """A peer, as ROS nodes are with rmw_zenoh."""

    def __init__(self, port: int, reads: list[LiveTopic], writes: list[LiveTopic]) -> None:
        import queue

        import zenoh

        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
        config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = None
        while self.session is None:
            try:
                self.session = zenoh.open(config)
            except zenoh.ZError:
                time.sleep(0.1)
        self.queue, self.tokens, self.attachments = queue.SimpleQueue(), [], []
        self.seen = self.session.liveliness().declare_subscriber(
            "@ros2_lv/**", lambda sample: self.tokens.append(str(sample.key_expr)), history=True
        )
        self.writers = {t.name: self.session.declare_publisher(zenoh_key(t, 0, "jazzy")) for t in writes}
        self.readers = [
            self.session.declare_subscriber(zenoh_key(t, 0, "jazzy"), lambda s, t=t: self._take(t, s))
            for t in reads
        ]

    def _take(self, topic, sample):
        self.attachments.append(sample.attachment.to_bytes())
        self.queue.put((topic, sample.payload.to_bytes()))

    def receive(self):
        return [self.queue.get() for _ in range(self.queue.qsize())]

    def publish(self, topic, message):
        self.writers[topic].put(bytes(message))


def published(name: str) -> LiveTopic:
    return next(topic for topic in PUBLISHED if topic.name == name)


class Hector:
    """Our hector behind messages."""

    READS = ("/tf_static", "/scan", "/odom", "/imu")

    def __init__(self, client) -> None:
        from slam_baselines.mapper import make_mapper

        self.client, self.mapper, self.mount = client, make_mapper("hector"), None
        self.odometry, self.imu, self.scans = {}, {}, {}

    def take(self, topic, message) -> None:
        if topic.name == "/tf_static":
            T = message.transforms[0].transform
            self.mount = pose_of(T.translation, T.rotation)
            return
        stamp = message.header.stamp.sec, message.header.stamp.nanosec
        {"/odom": self.odometry, "/imu": self.imu, "/scan": self.scans}[topic.name][stamp] = message
        self.work()

    def work(self) -> None:
        for stamp in sorted(set(self.odometry) & set(self.imu) & set(self.scans)):
            if self.mount is None:
                return
            odometry, imu, scan = (held.pop(stamp) for held in (self.odometry, self.imu, self.scans))
            self.map(odometry, imu, scan)

    def map(self, odometry, imu, scan) -> None:
        stamp = seconds(scan.header.stamp)
        if stamp < 1e-8:
            stamp = 0.0
        beams = beams_of(scan, len(scan.ranges))
        first, step, range_min, range_max = geometry(beams, len(scan.ranges))
        sensed = LaserScan(
            ranges=scan.ranges,
            angle_min=first,
            angle_increment=step,
            range_min=range_min,
            range_max=range_max,
            stamp=stamp,
            T_base_laser=self.mount,
        )
        q = imu.orientation
        attitude = pose_of(imu.linear_acceleration, q)
        rates, force = imu.angular_velocity, imu.linear_acceleration
        reading = Imu(
            stamp=stamp,
            roll=attitude.roll,
            pitch=attitude.pitch,
            angular_velocity=(rates.x, rates.y, rates.z),
            linear_acceleration=(force.x, force.y, force.z),
        )
        T_odom_base = pose_of(odometry.pose.pose.position, odometry.pose.pose.orientation).to_pose2()
        T_map_base = self.mapper.update(sensed, T_odom_base, reading)
        self.client.publish("/map", occupancy_grid(stamp, self.mapper.map()))
        T_map_odom = Pose3.from_pose2(T_map_base @ T_odom_base.inverse())
        self.client.publish("/tf", transforms(stamp, MAPPED[1:], (T_map_odom,)))


class Forward:
    """Drives ahead, some time after each scan."""

    READS = ("/scan",)

    def __init__(self, client, delay: float) -> None:
        self.client, self.delay = client, delay

    def take(self, topic, message) -> None:
        time.sleep(self.delay)
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.client.publish("/cmd_vel", net.stamped(stamp, 0.5, 0.2).cdr)


def main(middleware: str, place: int, mode: str, delay: float = 0.0) -> None:
    answers = [
        t for t in SUBSCRIBED if t.kind == TWIST_STAMPED or (mode == "hector" and t.name in ("/tf", "/map"))
    ]
    kind = Hector if mode == "hector" else Forward
    reads = [published(name) for name in kind.READS]
    client = {"dds": DdsClient, "zenoh": ZenohClient}[middleware](place, reads, answers)
    worker = Hector(client) if mode == "hector" else Forward(client, delay)
    end, told = time.monotonic() + QUIET, False
    while time.monotonic() < end:
        for topic, cdr in client.receive():
            worker.take(topic, typestore("jazzy").deserialize_cdr(cdr, topic.kind))
            end = time.monotonic() + QUIET
        if middleware == "zenoh" and len(client.attachments) >= 5 and not told:
            told = True
            sys.stdout.write(" ".join([client.attachments[0].hex(), *sorted(client.tokens)]) + "\n")
            sys.stdout.flush()
        time.sleep(0.0005)
    if middleware == "zenoh":
        client.session.close()  # its threads keep an interpreter of 3.13 from ending


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3], *map(float, sys.argv[4:]))

"""Live topics over DDS: jitter of 50 Hz scans, and the processor time that 10 Hz clouds take.

    python benchmarks/live.py [--seconds 30] [--domain 42]

A client in another process receives all scans and clouds. Jitter is the time by which a scan is published
too late at --rate 1. The share of a core is the processor time of the calls that publish; the middleware's
own threads send what a slow client missed, and are not in it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from typing import Any
from unittest.mock import patch

import numpy as np
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rich.console import Console

from lirs_validation.config import MANUAL, RunConfig
from lirs_validation.live import run as live_run
from lirs_validation.live.dds import CONFIG, LOOPBACK, DdsNode, raw_type
from lirs_validation.live.graph import PUBLISHED
from lirs_validation.live.options import LiveOptions
from lirs_validation.live.run import LiveRun, live

SIZE, LIDAR_50_HZ, LIDAR_CLOUDS = 2**20, "lms1xx", "vlp16"
"""Bytes in a mebibyte, and presets of the lidars."""


class MeteredNode(DdsNode):
    """Node that adds up the processor time and the bytes of published messages."""

    seconds, sent = 0.0, 0

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        """Send a message."""
        begun = time.thread_time()
        super().publish(topic, message)
        MeteredNode.seconds += time.thread_time() - begun
        MeteredNode.sent += len(message)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--domain", type=int, default=42)
    parser.add_argument("--client", action="store_true", help="only receive, as the other process does")
    given = parser.parse_args()
    if given.client:
        receive(given.domain)
    console = Console(width=120)
    console.print(f"load average: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for lidar in (LIDAR_50_HZ, LIDAR_CLOUDS):
        MeteredNode.seconds, MeteredNode.sent = 0.0, 0
        result = driven(lidar, given.seconds, given.domain)
        console.print(line(lidar, result, given.seconds))


def driven(lidar: str, seconds: float, domain: int) -> LiveRun:
    """Return a live drive with a client in another process."""
    config: dict[str, Any] = {"lidar": lidar, "seconds": seconds, "driver": MANUAL, "mapper": "client"}
    client = subprocess.Popen([sys.executable, __file__, "--client", "--domain", str(domain)])
    try:
        with patch.object(live_run, "open_middleware", MeteredNode):
            (result,) = live(RunConfig(source="simple", **config), LiveOptions(domain=domain))
    finally:
        client.kill()
        client.wait()
    return result


def receive(domain: int) -> None:
    """Receive scans and clouds until the process is killed."""
    _domain = Domain(domain, CONFIG.format(host=LOOPBACK, multicast="false"))
    participant = DomainParticipant(domain)
    reliable = Policy.Reliability.Reliable(duration(seconds=1))
    quality = Qos(reliable, Policy.History.KeepLast(10))
    wanted = [topic for topic in PUBLISHED if topic.name in ("/scan", "/points")]
    topics = [Topic(participant, f"rt{topic.name}", raw_type(topic.kind, "jazzy")) for topic in wanted]
    readers = [DataReader(participant, topic, quality) for topic in topics]
    while True:
        for reader in readers:
            reader.take(10)
        time.sleep(0.002)


def line(lidar: str, result: LiveRun, seconds: float) -> str:
    """Return the figures of a drive in one line."""
    jitter = 1e3 * np.array(result.bridge.jitter)
    return (
        f"{lidar}: {len(jitter) / seconds:.0f} scans a second, jitter p50 {np.median(jitter):.2f} ms, "
        f"p99 {np.percentile(jitter, 99):.2f} ms, longest {jitter.max():.1f} ms; "
        f"{MeteredNode.sent / SIZE / seconds:.1f} MiB a second, publishing took "
        f"{MeteredNode.seconds / seconds:.1%} of a core"
    )


if __name__ == "__main__":
    main()

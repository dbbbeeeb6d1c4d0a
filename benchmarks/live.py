"""Live topics over DDS: jitter of 50 Hz scans, processor time of 10 Hz clouds, shares that arrive.

    python benchmarks/live.py [--seconds 30] [--domain 42]

A client in another process receives all scans and clouds. Jitter is the time by which a scan is published
too late at --rate 1. The share of a core is the processor time of the calls that publish.
"""

from __future__ import annotations

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

from benchmarks.steps import arguments
from lirs_extensions.live import run as live_run
from lirs_extensions.live.dds import CONFIG, DdsNode, raw_type
from lirs_extensions.live.graph import LOOPBACK, PUBLISHED
from lirs_extensions.live.options import LiveOptions
from lirs_extensions.live.run import LiveRun, live
from lirs_validation.config import CLIENT, RunConfig

COUNTED, QUIET, START = ("/scan", "/points"), 3.0, 120.0
"""Topics of the client, and seconds without a message after which it ends: later, and at first."""
SIZE, LIDAR_50_HZ, LIDAR_CLOUDS = 2**20, "lms1xx", "vlp16"
"""Bytes in a mebibyte, and presets of the lidars."""


class MeteredNode(DdsNode):
    """Node that adds up the processor time and the bytes of published messages."""

    seconds, sent, messages = 0.0, 0, 0

    def publish(self, topic: str, message: bytes | bytearray) -> None:
        """Send a message."""
        begun = time.thread_time()
        super().publish(topic, message)
        MeteredNode.seconds += time.thread_time() - begun
        MeteredNode.sent += len(message)
        MeteredNode.messages += topic in COUNTED


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, seconds=30.0, domain=42, client=str)
    if given.client:
        print(receive(given.domain, given.client))
        return
    print(f"load average: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for lidar in (LIDAR_50_HZ, LIDAR_CLOUDS):
        for reliability in ("reliable", "best effort"):
            MeteredNode.seconds, MeteredNode.sent, MeteredNode.messages = 0.0, 0, 0
            result, received = driven(lidar, reliability, given.seconds, given.domain)
            jitter = 1e3 * np.array(result.bridge.jitter)
            print(
                f"{lidar}, {reliability}: {len(jitter) / given.seconds:.0f} scans a second, "
                f"jitter p50 {np.median(jitter):.2f} ms, p99 {np.percentile(jitter, 99):.2f} ms, "
                f"longest {jitter.max():.1f} ms; {MeteredNode.sent / SIZE / given.seconds:.1f} MiB a second, "
                f"publishing took {MeteredNode.seconds / given.seconds:.1%} of a core; "
                f"{received} of {MeteredNode.messages} scans and clouds received"
            )


def driven(lidar: str, reliability: str, seconds: float, domain: int) -> tuple[LiveRun, int]:
    """Return a live drive, and the number of messages that a client in another process received."""
    config: dict[str, Any] = {"lidar": lidar, "seconds": seconds, "driver": CLIENT, "mapper": "client"}
    command = [sys.executable, __file__, "--client", reliability, "--domain", str(domain)]
    client = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        with patch.object(live_run, "open_middleware", MeteredNode):
            (result,) = live(RunConfig(source="simple", **config), LiveOptions(domain=domain))
        received = int(client.communicate(timeout=60)[0])
    finally:
        client.kill()
    return result, received


def receive(domain: int, reliability: str) -> int:
    """Return the number of received scans and clouds, once no more come."""
    _domain = Domain(domain, CONFIG.format(host=LOOPBACK, multicast="false"))
    participant = DomainParticipant(domain)
    kinds = Policy.Reliability.Reliable(duration(seconds=1)), Policy.Reliability.BestEffort
    quality = Qos(kinds[reliability == "best effort"], Policy.History.KeepLast(10))
    wanted = [topic for topic in PUBLISHED if topic.name in COUNTED]
    topics = [Topic(participant, f"rt{topic.name}", raw_type(topic.kind, "jazzy")) for topic in wanted]
    readers = [DataReader(participant, topic, quality) for topic in topics]
    received, last = 0, time.monotonic()
    while time.monotonic() - last < (QUIET if received else START):
        found = sum(hasattr(sample, "cdr") for reader in readers for sample in reader.take(10))
        if found:
            received, last = received + found, time.monotonic()
        time.sleep(0.002)
    return received


if __name__ == "__main__":
    main()

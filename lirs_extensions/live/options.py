"""Options of live drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from lirs_wct.errors import ConfigError
from lirs_wct.option import Options, documented, option, positive, within

Distribution = Literal["humble", "jazzy", "kilted"]
LIVE = "Live topics (extra [live])"
MOST_DOMAIN = 232
"""Largest domain whose ports exist."""


@documented
@dataclass(frozen=True, kw_only=True)
class LiveOptions(Options):
    """Connection of a live drive to its client."""

    middleware: Literal["dds", "zenoh"] = option("dds", "Middleware of the client.", panel=LIVE)
    domain: int = option(0, "ROS_DOMAIN_ID of the client.", panel=LIVE, check=within(f"[0, {MOST_DOMAIN}]"))
    ros: Distribution = option("jazzy", "ROS distribution of the client: types and discovery.", panel=LIVE)
    host: str | None = option(
        None, "Address of this machine to serve other machines from; default: loopback only.", panel=LIVE
    )
    lockstep: bool = option(
        False,
        "Simulated time waits for the client's answer to each scan (see the option `answer`).",
        panel=LIVE,
    )
    every: int = option(
        1,
        "With --lockstep: wait for an answer to every K-th scan.",
        metavar="K",
        panel=LIVE,
        check=within("[1, inf)"),
        rare=True,
    )
    answer: Literal["any", "cmd_vel", "tf"] = option(
        "any",
        "Answer to a scan, stamped at or after it: TwistStamped on /cmd_vel, or map -> odom on /tf.",
        panel=LIVE,
        rare=True,
    )
    limit: float = option(
        5.0,
        "Wall seconds to wait for an answer; then the scan counts as skipped.",
        metavar="S",
        panel=LIVE,
        check=positive,
        rare=True,
    )
    rate: float = option(
        1.0, "Simulated seconds per wall second, without --lockstep.", panel=LIVE, check=positive
    )
    wait: float = option(
        60.0,
        "Wall seconds to wait for a first subscriber of /scan or /points.",
        metavar="S",
        panel=LIVE,
        check=within("[0, inf)"),
        rare=True,
    )
    client: str = option("client", "Name of the client in records and tables.", metavar="NAME", panel=LIVE)
    port: int = option(
        7447, "TCP port of the Zenoh router.", panel=LIVE, check=within("[1, 65535]"), rare=True
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.every > 1 and not self.lockstep:
            raise ConfigError("the option every is for --lockstep")
        if self.lockstep and self.rate != 1.0:
            raise ConfigError("--rate is for drives without --lockstep: simulated time waits for the client")
        if not self.client.replace("_", "").replace("-", "").isalnum():
            raise ConfigError(f"--client must be letters, digits, - and _, got {self.client!r}")

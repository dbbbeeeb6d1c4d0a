"""Does SLAM work on this terrain? One robot, three mappers, the same drive; error and speed of each.

python examples/validate_slam.py [SOURCE] [--seconds 60] [-o FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lirs_validation import validate

DUNES = Path(__file__).with_name("data") / "dunes.png"


def main() -> None:
    """Drive once for each mapper and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", nargs="?", default=DUNES)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("-o", "--out", type=Path, default=Path("out"))
    given = parser.parse_args()
    for mapper in ("hector", "gmapping", "cartographer"):
        record = validate(given.source, mapper=mapper, seconds=given.seconds, seed=1, out=given.out).record
        ate, odometry = (record.trajectory[key] for key in ("ate_rmse", "odometry_ate_rmse"))
        rtf = record.rtf["mean"]
        print(f"{mapper:12} {record.status}: ATE {ate:.3f} m (odometry {odometry:.3f} m), RTF {rtf:.0f}")


if __name__ == "__main__":
    main()

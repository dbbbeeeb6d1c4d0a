"""A robot's laser log becomes a map, and the map a world to drive in.

python examples/map_a_log.py [LOG] [-o FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lirs_validation import map_log, validate

OFFICE = Path(__file__).with_name("data") / "office.clf.gz"


def main() -> None:
    """Map the log, then drive through the world made of its map."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", nargs="?", type=Path, default=OFFICE)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("-o", "--out", type=Path, default=Path("out"))
    given = parser.parse_args()
    mapped = map_log(given.log, mapper="cartographer", out=given.out)
    print(f"{len(mapped.trajectory)} scans, map of {mapped.grid.shape[1]} x {mapped.grid.shape[0]} cells")
    assert mapped.folder is not None
    record = validate(
        mapped.folder / "map.yaml", robot="turtlebot2", seconds=given.seconds, out=given.out
    ).record
    print(
        f"a TurtleBot 2 in the world of that map: {record.status}, ATE {record.trajectory['ate_rmse']:.3f} m"
    )


if __name__ == "__main__":
    main()

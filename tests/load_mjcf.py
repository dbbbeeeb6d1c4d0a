"""Loads written worlds with the MuJoCo at hand, which may be an old one, and drops a ball on each start.

    python tests/load_mjcf.py WORLD.xml ...

Needs mujoco and nothing else: neither pytest nor this package.
"""

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco

RADIUS = 0.1
SECONDS = 1.5
SINKS = 0.05
"""Meters that a ball may lie lower than it touches: slopes push it aside meanwhile."""


def dropped(path):
    """Return the least height of balls above the starts of a world, after they fell on its ground."""
    tree = ElementTree.parse(path)
    body = tree.find("worldbody")
    starts = [s for s in body.findall("site") if s.get("name", "").startswith("start")]
    assert starts, f"{path}: has no site for a start"
    for site in starts:
        x, y, z = (float(v) for v in site.get("pos").split())
        ball = ElementTree.SubElement(body, "body", pos=f"{x} {y} {z + 2 * RADIUS}")
        ElementTree.SubElement(ball, "freejoint")
        ElementTree.SubElement(ball, "geom", size=str(RADIUS), mass="1", condim="6", friction="1 0.1 0.1")
    beside = str(path) + ".balls.xml"
    tree.write(beside)
    try:
        model = mujoco.MjModel.from_xml_path(beside)
    finally:
        Path(beside).unlink()
    data = mujoco.MjData(model)
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
    heights = [float(site.get("pos").split()[2]) for site in starts]
    return min(data.xpos[k + 1][2] - z for k, z in enumerate(heights)), len(starts)


if __name__ == "__main__":
    for given in sys.argv[1:]:
        lowest, count = dropped(given)
        assert lowest > RADIUS - SINKS, f"{given}: a ball fell through the ground to {lowest:.3f} m"
        sys.stdout.write(f"MuJoCo {mujoco.__version__}: {given}: {count} balls lie on the ground\n")

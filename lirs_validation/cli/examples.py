"""Examples that the help of each command ends with; their inputs ship with the repository."""

from __future__ import annotations

from collections.abc import Mapping

EXAMPLES: Mapping[str, tuple[str, ...]] = {
    "build": (
        "lirs-wct build examples/data/dunes.png --size 30 --height 2.5 -o worlds/",
        "lirs-wct build examples/data/office.yaml --wall-height 2 --to mjcf -o worlds/",
    ),
    "report": ("lirs-wct report out/ -o report.html --markdown report.md",),
    "compare": (
        "lirs-wct compare out/a out/b",
        "lirs-wct compare out/ out/ --across mapper --only-a mapper=hector --only-b mapper=gmapping",
    ),
    "score": ("lirs-wct score out/RUN --trajectory est.tum --map map.yaml -o score.json",),
    "export": ("lirs-wct export out/RUN --to bag,csv -o exported/",),
    "bench": (
        "lirs-wct bench straight go_to_goal astar --set lirs --task navigation -o out/",
        "lirs-wct bench my_policy:MyPolicy --set hills -o out/",
    ),
    "collide": ("lirs-wct collide simple advanced --robot husky,turtlebot2 --seconds 60 -o out/",),
    "view": (
        "lirs-wct view examples/data/dunes.png -o dunes-view.png",
        "lirs-wct view examples/data/office.yaml --oblique -o office.png",
    ),
    "info": ("lirs-wct info examples/data/office.yaml --robot turtlebot2",),
    "convert": ("lirs-wct convert terrain.stl terrain.dae",),
    "robot": ("lirs-wct robot husky",),
    "mappers": ("lirs-wct mappers",),
    "doctor": ("lirs-wct doctor",),
    "gui": ("lirs-wct gui medium --port 8080",),
    "validate": (
        "lirs-wct validate examples/data/dunes.png --mapper hector --seconds 60 --seed 1 -o out/",
        "lirs-wct validate simple medium --robot husky,jackal --mapper hector,gmapping --seeds 1-5 -o out/",
        "lirs-wct validate medium --lidar vlp16 --mapper kiss-icp,genz-icp,hector --seeds 1-3 -o out/",
    ),
    "verdict": (
        "lirs-wct verdict medium --robot jackal --mapper hector,gmapping --budget 10min -o verdict/",
    ),
    "falsify": (
        "lirs-wct falsify --mapper hector --drives 150 --jobs 2 -o failures/",
        "lirs-wct falsify --policy go_to_goal --drives 60 -o failures/",
        "lirs-wct validate --suite failures/cases.yaml -o out/",
    ),
    "tune": (
        "lirs-wct tune medium --robot husky --mapper gmapping_original --seconds 40 -o tune/",
        "lirs-wct tune examples/data/office.clf.gz --mapper hector_original --unseen 4 -o tune/",
    ),
    "record": ("lirs-wct record simple --seconds 60 -o run",),
    "live": (
        "lirs-wct live simple --robot husky --lockstep --seconds 60 -o out/",
        "lirs-wct live medium --driver tour --client slam_toolbox --rate 1 -o out/",
    ),
    "map": ("lirs-wct map examples/data/office.clf.gz --mapper gmapping -o out/",),
    "twin": (
        "lirs-wct twin examples/data/office.clf.gz -o out/",
        "lirs-wct validate examples/data/office.yaml --noise out/office-TWIN/noise.yaml -o out/",
    ),
}
"""Command lines by command."""


def epilog(command: str) -> str:
    """Return the examples of a command as its help shows them: one a line."""
    return "\n\n".join(("Examples:", *EXAMPLES[command]))

"""Shell commands and Python programs of the pages, in their order, and forms of them that take seconds."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted((DOCS / "tutorial").glob("*.md")),
    *sorted((DOCS / "howto").glob("*.md")),
    DOCS / "reference" / "command_line.md",
]
STEP = re.compile(
    r"^```python\n(?P<program>(?:.*\n)*?)```"
    r"|^(?:\$ | {4})?(?P<line>(?:lirs-wct|python|kiss_icp_pipeline|rosbags-convert) .*)$"
    r"|`(?P<quoted>lirs-wct [a-z][^`]* [^`]*)`",
    re.MULTILINE,
)

SHORT = {
    "validate": "--seconds 1 --seed 1",
    "verdict": "--seconds 15 --budget 1s",
    "record": "--seconds 4",
    "collide": "--seconds 1",
    "falsify": "--drives 4 --seconds 2 -o search",
    "tune": "--drives 3",
    "twin": "--draws 4",
    "live": "--seconds 5",
}
"""Options that make a command short."""
FEWER = {
    "0,5,20": "5",
    "gmapping,hector,cartographer": "hector",
    "husky,jackal": "husky",
    "--set indoor": "--set lirs",
    "tune medium": "tune medium --seconds 20 --repeats 1 --unseen 3",
    "tune map.yaml": "tune map.yaml --seconds 20 --repeats 1 --unseen 3",
    "--world": "--tasks 1 --world",
    "--rays mujoco": "--rays mujoco --option resize=65,65",
    "slam:/Odometry": "run:/odom",
    "slam:/pose": "run:/ground_truth",
    "--client": "--option wait=0 --client",
}
"""Values in place of lists of them, of larger ones, and of what only a client makes."""


@dataclass(frozen=True)
class Step:
    """Command of a shell, or program.

    Attributes:
        text: The command without prompt and comment, or the lines of the program.
        program: Whether it is Python.
    """

    text: str
    program: bool


def steps(page: Path) -> list[Step]:
    """Return the commands and programs of a page, each once."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    found = []
    for match in STEP.finditer(text):
        if match["program"]:
            found.append(Step(match["program"], program=True))
        else:
            command = re.split(r"\s+#", match["line"] or match["quoted"])[0]
            found.append(Step(" ".join(command.split()), program=False))
    return list(dict.fromkeys(found))


def shortened(command: str) -> str:
    """Return a command that takes seconds: the last of an option counts."""
    name = command.split()[1]
    if name in SHORT:
        command = re.sub(r" --(seed|seconds) \S+", "", command)
    for text, other in FEWER.items():
        command = command.replace(text, other)
    return f"{command} {SHORT.get(name, '')}".strip()

"""The workflow files are sound, and the shell steps of the action do what its page says.

A stand-in for the runner's environment runs the steps; GitHub's runner itself is not used.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.command_line import check_command

ROOT = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
ACTION = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
PAGE = (ROOT / "docs" / "howto" / "continuous_integration.md").read_text(encoding="utf-8")
ROS2 = ROOT / "examples" / "ros2"
EXPRESSION = re.compile(r"\${{ *([\w.-]+) *}}")
UPLOADS = {"picture": "https://example.org/picture", "results": "https://example.org/results"}
"""Addresses that stand in for those of uploaded artifacts."""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of what actionlint reads; by its folder `.git` it knows what `./` is."""
    (tmp_path / ".git").mkdir()
    shutil.copytree(ROOT / ".github", tmp_path / ".github")
    shutil.copy(ROOT / "action.yml", tmp_path)
    return tmp_path


def actionlint(checkout: Path, text: str) -> str:
    """Return what actionlint finds in a workflow."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    program = shutil.which("actionlint", path=path)
    if program is None:
        pytest.skip("actionlint is not installed (extra [dev])")
    workflow = checkout / ".github" / "workflows" / "read.yml"
    workflow.write_text(text, encoding="utf-8")
    # Other checkers may be anywhere on the path, or not.
    command = [program, "-oneline", "-no-color", "-shellcheck=", "-pyflakes=", workflow]
    done = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    return done.stdout


def example() -> str:
    """Return the page's workflow, with this repository's action."""
    block = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert block is not None
    return re.sub(r"OWNER/lirs-wct@\S+", "./", block[1])


def used() -> set[str]:
    """Return the actions of others that the workflows, the action and the page use."""
    texts = [*(path.read_text(encoding="utf-8") for path in (*WORKFLOWS, ROOT / "action.yml")), PAGE]
    found = {name for text in texts for name in re.findall(r"uses: (\S+)", text)}
    return {name for name in found if not name.startswith(("./", "OWNER/"))}


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actionlint_finds_nothing(path: Path, checkout: Path) -> None:
    assert actionlint(checkout, path.read_text(encoding="utf-8")) == ""


def test_actionlint_finds_nothing_in_the_steps_of_the_action(checkout: Path) -> None:
    """It reads workflows alone, hence the steps stand in one."""
    inputs = {name: {"type": "string"} for name in ACTION["inputs"]}
    steps = {"runs-on": "ubuntu-latest", "steps": ACTION["runs"]["steps"]}
    text = yaml.safe_dump({"on": {"workflow_call": {"inputs": inputs}}, "jobs": {"steps": steps}})
    assert actionlint(checkout, text) == ""
    assert '"limit" is not defined' in actionlint(checkout, text.replace("inputs.limits", "inputs.limit"))


def test_the_workflow_of_the_page_is_sound_and_names_inputs_of_the_action(checkout: Path) -> None:
    assert actionlint(checkout, example()) == ""
    assert '"limit" is not defined' in actionlint(checkout, example().replace("limits:", "limit:"))
    assert re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE) == list(ACTION["inputs"])


def test_actions_of_others_have_versions_that_exist(checkout: Path) -> None:
    """Actionlint knows the inputs of versions that exist, and takes any input of others."""
    head = "on: push\njobs:\n  a:\n    runs-on: ubuntu-latest\n    steps:\n"
    for name in (*used(), "actions/checkout@v999"):
        found = actionlint(checkout, f"{head}      - uses: {name}\n        with: {{nonsense: 1}}\n")
        assert ('"nonsense" is not defined' in found) == (not name.endswith("v999")), name
    assert [name for name in used() if not re.search(r"@(release/)?v\d+$", name)] == []


def test_expressions_reach_no_script_of_the_action() -> None:
    """An input within a script would be run as part of it."""
    assert [step["name"] for step in ACTION["runs"]["steps"] if "${{" in step.get("run", "")] == []


@dataclass
class Runner:
    """A stand-in for the runner: environment, outputs and step summary.

    Attributes:
        home: temporary folder, which holds the checkout.
        inputs: values given to the action.
        outputs: values by step and name.
    """

    home: Path
    inputs: dict[str, str]
    outputs: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def summary(self) -> Path:
        return self.home / "summary.md"

    def value(self, text: str) -> str:
        """Return a text with the values of its expressions; those of other kinds are refused."""
        values = {
            f"inputs.{name}": given["default"]
            for name, given in ACTION["inputs"].items()
            if "default" in given
        }
        values |= {f"inputs.{name}": given for name, given in self.inputs.items()}
        return EXPRESSION.sub(lambda found: values.get(found[1]) or self.output(found[1]), text)

    def output(self, name: str) -> str:
        match name.split("."):
            case "steps", step, "outputs", key:
                return self.outputs.get(step, {}).get(key, "")
            case "inputs", _:
                return ""
        raise AssertionError(f"the stand-in knows no {name}")

    def run(self, step: dict[str, Any]) -> int:
        """Run a shell step as the runner does, and return its exit code."""
        assert step["shell"] == "bash"
        script, output = self.home / "step.sh", self.home / "output"
        script.write_text(step["run"], encoding="utf-8")
        output.write_text("", encoding="utf-8")
        path = os.pathsep.join((str(self.home / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]))
        modules = os.pathsep.join((str(ROOT), str(ROOT / "envs"), os.environ.get("PYTHONPATH", "")))
        given = {name: self.value(text) for name, text in step.get("env", {}).items()}
        runner = {
            "GITHUB_ACTION_PATH": str(ROOT), "RUNNER_TEMP": str(self.home), "GITHUB_OUTPUT": str(output),
            "GITHUB_STEP_SUMMARY": str(self.summary), "PATH": path, "PYTHONPATH": modules,
        }  # fmt: skip
        command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", script]
        done = subprocess.run(command, cwd=self.home, env=os.environ | runner | given, check=False)
        if "id" in step:
            lines = output.read_text(encoding="utf-8").splitlines()
            self.outputs[step["id"]] = dict(line.split("=", 1) for line in lines)
        return done.returncode


def drive(home: Path, **inputs: str) -> tuple[int, Runner]:
    """Run the action's steps after the installation; return the exit code of the job."""
    (home / "mine.py").write_text(
        "from examples.your_own_mapper import DeadReckoning as Mine\n", encoding="utf-8"
    )
    runner = Runner(home, {"seconds": "20", "worlds": "medium", **inputs})
    for step in ACTION["runs"]["steps"][1:]:
        if "uses" in step:
            if "if" not in step or runner.output(step["if"].removesuffix(" != ''")):
                assert Path(runner.value(step["with"]["path"])).exists()
                runner.outputs[step["id"]] = {"artifact-url": UPLOADS[step["id"]]}
        elif code := runner.run(step):
            return code, runner
    return 0, runner


@pytest.mark.slow
def test_the_action_passes_where_every_verdict_works(tmp_path: Path) -> None:
    code, runner = drive(tmp_path, mapper="hector")
    assert code == 0
    summary = runner.summary.read_text(encoding="utf-8")
    assert "| works | hector on husky works on medium." in summary
    assert "| medium | hector | 1 of 1 |" in summary
    assert f"\n- [Paths and map of one run]({UPLOADS['picture']})" in summary
    assert f"\n- [Report and all results]({UPLOADS['results']})" in summary
    assert "gate" not in summary
    folder = Path(runner.outputs["drive"]["folder"])
    (run,) = (path.parent for path in folder.glob("*/record.json"))
    assert (folder / "report.html").is_file()
    assert (folder / "lirs-wct.png").read_bytes() == (run / "overview.png").read_bytes()


@pytest.mark.slow
def test_the_gate_fails_the_job_unless_the_limits_or_the_user_say_otherwise(tmp_path: Path) -> None:
    """The picture is that of the run that does not work."""
    code, runner = drive(tmp_path, mapper="hector,mine.py:Mine")
    assert code == 4
    summary = runner.summary.read_text(encoding="utf-8")
    assert "| works | hector on husky works" in summary
    assert "| adds nothing | Mine on husky adds nothing to the odometry" in summary
    assert "**The gate failed:**" in summary
    folder = Path(runner.outputs["drive"]["folder"])
    (run,) = (path.parent for path in folder.glob("*/record.json") if "hector" not in path.parent.name)
    assert (folder / "lirs-wct.png").read_bytes() == (run / "overview.png").read_bytes()

    (tmp_path / "limits.yaml").write_text("small_error: 0.2\n", encoding="utf-8")
    runner.summary.unlink()
    assert drive(tmp_path, mapper="mine.py:Mine", limits="limits.yaml")[0] == 0
    assert "| works | Mine on husky works" in runner.summary.read_text(encoding="utf-8")
    assert drive(tmp_path, mapper="mine.py:Mine", gate="false")[0] == 0


@pytest.mark.slow
def test_with_a_baseline_the_gate_fails_for_what_got_worse(tmp_path: Path) -> None:
    inputs = {"mapper": "mine.py:Mine", "seeds": "1-3"}
    code, runner = drive(tmp_path, gate="false", **inputs)
    assert code == 0
    stored = tmp_path / "baseline"
    shutil.copytree(runner.outputs["drive"]["folder"], stored, ignore=lambda _, names: [
        name for name in names if "." in name and name != "record.json"
    ])  # fmt: skip
    for path in stored.glob("*/record.json"):
        record = yaml.safe_load(path.read_text(encoding="utf-8"))
        record["trajectory"]["ate_rmse"] -= 0.03 + 0.001 * record["seed"]
        path.write_text(json.dumps(record), encoding="utf-8")
    runner.summary.unlink()
    assert drive(tmp_path, baseline="baseline", **inputs)[0] == 4
    summary = runner.summary.read_text(encoding="utf-8")
    assert "\n- worse than the baseline: ATE of mine.py:Mine on medium, husky: " in summary
    assert "**The gate failed:**" in summary


@pytest.mark.slow
def test_wrong_input_fails_the_job(tmp_path: Path) -> None:
    code, runner = drive(tmp_path, mapper="hector", worlds="nowhere.png")
    assert code == 2
    assert "failed** with exit code 2" in runner.summary.read_text(encoding="utf-8")
    assert drive(tmp_path, mapper="hector", gate="yes")[0] == 2


@pytest.mark.slow
def test_the_first_step_installs_the_checkout_of_the_action(tmp_path: Path) -> None:
    """Pip reads the project, and installs nothing."""
    report, python = tmp_path / "report.json", tmp_path / "bin" / "python"
    python.parent.mkdir()
    options = f"--dry-run --no-deps --ignore-installed --report {report}"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@" {options}\n', encoding="utf-8")
    python.chmod(0o755)
    assert Runner(tmp_path, {}).run(ACTION["runs"]["steps"][0]) == 0
    (installed,) = yaml.safe_load(report.read_text(encoding="utf-8"))["install"]
    assert installed["metadata"]["name"] == "lirs-wct"
    assert installed["download_info"]["url"] == ROOT.as_uri()


def run_release_step(home: Path, file: str, tag: str) -> subprocess.CompletedProcess[str]:
    """Run the step of a release that names a file."""
    steps = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text())["jobs"]["build"]["steps"]
    (script,) = (step["run"] for step in steps if file in step.get("run", ""))
    given = {"GITHUB_REF_NAME": tag, "GITHUB_REPOSITORY": "owner/lirs-wct"}
    return subprocess.run(
        ["bash", "-e", "-c", script],
        cwd=home,
        env=os.environ | given,
        capture_output=True,
        text=True,
        check=False,
    )


def release_step(home: Path, tag: str, version: str) -> subprocess.CompletedProcess[str]:
    """Run the step that checks a release, on a copy of the files that it reads."""
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    mine = tomllib.loads(project)["project"]["version"]
    (home / "pyproject.toml").write_text(project.replace(f'version = "{mine}"', f'version = "{version}"'))
    changes = "# Changelog\n\n## 9.1.0 (2030-01-02)\n\n- New.\n\n## 9.0.0 (2029-01-02)\n\n- Old.\n"
    (home / "CHANGELOG.md").write_text(changes)
    return run_release_step(home, "notes.md", tag)


def test_pypi_shows_pictures_and_links_of_the_readme(tmp_path: Path) -> None:
    source = "![A b](docs/a.gif) and [c](docs/c.md#d) · [e](https://e.org/f), [g](examples)\n"
    (tmp_path / "README.md").write_text(source)
    assert run_release_step(tmp_path, "README.md", "v1.1.0").returncode == 0
    page = "https://github.com/owner/lirs-wct/blob/v1.1.0"
    assert (tmp_path / "README.md").read_text() == (
        "![A b](https://raw.githubusercontent.com/owner/lirs-wct/v1.1.0/docs/a.gif) and "
        f"[c]({page}/docs/c.md#d) · [e](https://e.org/f), [g]({page}/examples)\n"
    )


def test_a_release_needs_the_tag_of_its_version_and_a_part_of_the_changelog(tmp_path: Path) -> None:
    assert release_step(tmp_path, "v9.1.0", "9.1.0").returncode == 0
    assert (tmp_path / "notes.md").read_text().split() == ["-", "New."]
    assert "pyproject.toml has version 9.0.0" in release_step(tmp_path, "v9.1.0", "9.0.0").stdout
    assert "no part on 9.2.0" in release_step(tmp_path, "v9.2.0", "9.2.0").stdout


def test_the_containers_run_a_command_of_ours_with_the_parameters_of_the_page() -> None:
    services = yaml.safe_load((ROS2 / "compose.yaml").read_text(encoding="utf-8"))["services"]
    check_command(services["live"]["command"])
    page = (ROOT / "docs" / "howto" / "live.md").read_text(encoding="utf-8")
    assert f"# slam.yaml\n{(ROS2 / 'slam.yaml').read_text(encoding='utf-8')}```" in page

"""Compile the kernels into numba's cache, each once: workers of pytest would each compile them."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

OFFICE = str(Path(__file__).resolve().parents[1] / "examples" / "data" / "office.yaml")


def compile_mappers() -> None:
    from slam_baselines.mapper import MAPPERS
    from slam_baselines.warm_up import warm_up

    for name in MAPPERS:
        warm_up(name)


def compile_simulation() -> None:
    from lirs_envs.vector_env import RobotVectorEnv
    from lirs_wct import build_world, write_package

    for task, world, robot in (("navigation", "medium", "husky"), ("mapping", OFFICE, "turtlebot2")):
        envs = RobotVectorEnv(2, task, threads=1, world=world, robot=robot)
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()
    with TemporaryDirectory() as folder:
        write_package(build_world("simple"), folder)


def compile_evaluation() -> None:
    from lirs_validation import validate

    validate("medium", seconds=2, mapper="hector")


if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        for job in [processes.submit(compile_mappers), processes.submit(compile_simulation)]:
            job.result()
    compile_evaluation()

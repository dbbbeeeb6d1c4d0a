"""Compile the kernels into numba's cache, each once: workers of pytest would each compile them."""

import gc
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

gc.set_threshold(100_000, 50, 50)  # the compiler makes many objects, and little garbage
OFFICE = str(Path(__file__).resolve().parents[1] / "examples" / "data" / "office.yaml")
HILL = """<mujoco><asset><hfield name="h" nrow="9" ncol="9" size="8 8 1 .1"/></asset>
  <worldbody><geom type="hfield" hfield="h"/>
  <body pos="0 0 2"><freejoint/><geom size=".1"/><site name="lidar"/></body>
  </worldbody></mujoco>"""


def compile_mappers() -> None:
    from slam_baselines.mapper import MAPPERS, warm_up

    for name in MAPPERS:
        warm_up(name)


def compile_simulation() -> None:
    import mujoco

    from lirs_envs.episodes.observations import GROUPS
    from lirs_envs.lidar import TerrainLidar
    from lirs_envs.vector_env import RobotVectorEnv
    from lirs_wct import build_world, write_package

    for task, world, robot in (("navigation", "medium", "husky"), ("mapping", OFFICE, "turtlebot2")):
        observe = list(GROUPS) if task == "navigation" else None
        envs = RobotVectorEnv(2, task, threads=1, world=world, robot=robot, actors=2, observe=observe)
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()
    for source in ("simple", OFFICE):
        with TemporaryDirectory() as folder:
            write_package(build_world(source), folder)
    model = mujoco.MjModel.from_xml_string(HILL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    TerrainLidar(model, "lidar", "vlp16").trace(data)


def compile_evaluation() -> None:
    from lirs_validation import validate

    validate("medium", seconds=2, mapper="hector")
    validate(OFFICE, robot="turtlebot2", seconds=3, mapper="wheel_lio", lidar="vlp16", actors=2)


if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        for job in [processes.submit(compile_mappers), processes.submit(compile_simulation)]:
            job.result()
    compile_evaluation()

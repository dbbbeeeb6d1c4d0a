"""Robot and world as one compiled MuJoCo model: state, contacts, and the check for divergence."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from lirs_envs.robots.control import BodyState
from lirs_envs.robots.robot import Robot
from lirs_envs.simulation_config import STATIC_ROBOT, SimulationConfig, add_props
from lirs_envs.walkers import Walkers, add_walkers
from lirs_wct import ConfigError, Pose3, SimulationError, World
from lirs_wct.arrays import FloatArray, Int32Array, IntArray, njit
from lirs_wct.contact.spec import ContactGrid, contact_grid, surface_itself, world_spec, write_heights

FULL_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""State on which the next step depends, including the warm start."""
CONTROL_PERIOD = 0.008
"""Time between two control updates, seconds, as nearly as whole steps allow."""
REFERENCE_TIMESTEP = 0.004
"""Longest step of the reference physics, seconds, whatever a robot's own step is."""
SETTLING_TIME = 0.6
"""Time for a robot to come to rest after its placement, seconds."""
CONTACT_SENSOR, CENTER_SENSOR = "touch_", "center_"
"""Name prefixes of the contact sensors, one per contact geom, and of the wheels' position sensors."""
WHEEL_CONTACTS = 16
"""Capacity of a wheel's contact sensor; on ground and at a wall there are up to 6 contacts."""
FACE_MARGIN = math.radians(10)
"""Margin of a single face above the robot's `max_slope`, which is a mean over 0.3 m.

On ground that it may drive, contacts of a wheel come up to 7 deg above it, 2 of them by its own deformation.
"""
TIPPED = 0.5
"""Cosine of the tilt from which a robot counts as tipped: 60 deg."""


class RobotModel(BodyState):
    """MuJoCo's model and data of one robot in one world.

    Attributes:
        contact: Grid that wheels touch.
        period: Time from scan to scan, seconds.
        timestep: Longest part of the period that is at most the robot's own step, seconds.
        substeps: Number of steps of each control update of one period.
        wheel_geoms: Ids of the geoms that are meant to touch the ground.
        contact_drops: (ngeom,) least height of a geom's center above a contact that is no collision, meters;
            inf = every contact is one (the body), -inf = the geom is not the robot's.
        actuators: Ids of the actuators of the wheels on the left and on the right, or of each rotor.
        ctrl: (nu,) controls, to be written: wheel speeds, rad/s, or rotor thrusts, newtons.
        walker_centers: (m, 3) centers of the walkers with a body, to be written.
        force: (3,) the accelerometer's true reading along x, y, z of the base, m/s^2, live.

    Args:
        config: Robot, props, walkers, contact geometry and height range.
        period: Time from scan to scan, seconds: a whole number of steps.
        contact_sensors: Whether the model has sensors of the robot's contacts.
    """

    def __init__(
        self, world: World, config: SimulationConfig, period: float, *, contact_sensors: bool = False
    ) -> None:
        robot, height_range = config.robot, config.height_range
        if height_range is not None and world.kind != "terrain":
            raise ConfigError(f"{world.name}: a height_range is for terrains, this world is a {world.kind}")
        self.contact: ContactGrid = (contact_grid if height_range is None else surface_itself)(world.surface)
        spec = mujoco.MjSpec.from_file(str(robot.mjcf))
        self.period = period
        spec.option.timestep = self.timestep = _even_part(period, spec.option.timestep)
        steps = round(period / self.timestep)
        most = max(1, round(CONTROL_PERIOD / self.timestep))
        self.substeps = tuple(min(most, steps - done) for done in range(0, steps, most))
        if contact_sensors:
            _add_contact_sensors(spec, robot)
        add_props(spec, world, config.props)
        if config.actors:
            add_walkers(spec, config.walker_bodies)
        model = world_spec(
            world,
            contact=self.contact,
            robot=spec,
            contact_geometry=config.contact_geometry,
            ray_surface=config.rays == "mujoco",
            height_range=height_range,
        ).compile()
        super().__init__(model, robot)
        if height_range is not None:
            write_heights(self.model, world.surface, height_range)
        self.data = mujoco.MjData(self.model)
        self._find_contact_geoms(robot)
        self._flies = robot.flies
        wheels: list[tuple[str, ...]] = [robot.left_wheels, robot.right_wheels]
        sides = [(rotor,) for rotor in robot.rotors] or wheels
        self.actuators = [[int(self.model.actuator(name).id) for name in side] for side in sides]
        self._make_views()

    def _find_contact_geoms(self, robot: Robot) -> None:
        """Note the geoms of wheels and casters, and the least height above a contact of each geom.

        A wheel of radius r touches a face of slope s at r cos(s) below its center. Normals of MuJoCo's
        contacts are no measure: between two prisms of a height field some are level.
        """
        model = self.model
        wheels = {int(model.joint(name).bodyid[0]) for name in (*robot.left_wheels, *robot.right_wheels)}
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        self.wheel_geoms = frozenset(
            geom
            for geom, name in enumerate(names)
            if int(model.geom_bodyid[geom]) in wheels
            or (name.endswith("caster") and not name.startswith(STATIC_ROBOT))
        )
        own, rolling = model.body_rootid[model.geom_bodyid] == model.body("base_link").id, [*self.wheel_geoms]
        self.contact_drops: FloatArray = np.where(own, np.inf, -np.inf)
        self.contact_drops[rolling] = math.cos(robot.max_slope + FACE_MARGIN) * model.geom_size[rolling, 0]

    def _make_views(self) -> None:
        """Make views into the data once: making one costs as much as reading it."""
        self.qpos = self.data.qpos
        self.qvel = self.data.qvel
        self.ctrl: FloatArray = self.data.ctrl
        self.force: FloatArray = self.data.sensor("accelerometer").data
        self.walker_centers: FloatArray = self.data.mocap_pos

    def __getstate__(self) -> dict[str, Any]:
        # The data holds the model, and a copied view would be an array that is no longer updated.
        left_out = ("model", "qpos", "qvel", "ctrl", "force", "walker_centers")
        return {name: value for name, value in self.__dict__.items() if name not in left_out}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.model = self.data.model
        self._make_views()

    @property
    def tipped(self) -> bool:
        """Whether the robot tilts by more than 60 deg or lies on its back."""
        return is_tipped(self.pose())

    def step(self, steps: int) -> None:
        """Step with the present controls."""
        mujoco.mj_step(self.model, self.data, steps)

    def settle(
        self, T_world_base: Pose3, walkers: FloatArray | None = None, *, seconds: float = SETTLING_TIME
    ) -> None:
        """Release the robot in a pose with its wheels held, and settle.

        The time is 0 afterwards. A robot that flies begins in the air, with the thrust that carries it.

        Args:
            T_world_base: Pose of the release.
            walkers: (m, 3) centers of the walkers within its reach, meters; they stand.
            seconds: Time to settle.
        """
        mujoco.mj_resetData(self.model, self.data)
        if walkers is not None:
            self.walker_centers[:] = walkers
        self.qpos[:7] = (*T_world_base.position, *T_world_base.quaternion)
        if self._flies:
            weight = float(self.model.body("base_link").subtreemass[0]) * self.gravity
            self.ctrl[:] = weight / len(self.actuators)
            mujoco.mj_forward(self.model, self.data)
        else:
            self.step(math.ceil(seconds / self.timestep))
        self.data.time = 0.0

    def state(self) -> FloatArray:
        """Return the whole state."""
        state = np.empty(mujoco.mj_stateSize(self.model, FULL_STATE))
        mujoco.mj_getState(self.model, self.data, state, FULL_STATE)
        return state

    def replay(
        self,
        initial: FloatArray,
        controls: FloatArray,
        walkers: Walkers | None = None,
        *,
        reference: bool = False,
    ) -> tuple[float, Pose3]:
        """Step from a state with given controls, one per control update; restore the present state.

        Args:
            initial: State to begin in.
            controls: (n, nu) controls of each update.
            walkers: Walkers around the robot, which walk on.
            reference: Whether to take the reference physics' step; a control then is in force at the steps
                that begin within its update.

        Returns:
            Wall-clock seconds, and the last pose.
        """
        present, own, warnings = self.state(), self.timestep, self.data.warning.number.copy()
        timestep = _even_part(self.period, REFERENCE_TIMESTEP) if reference else own
        # Steps that begin within each control update of a period.
        ends = np.ceil(np.cumsum(self.substeps) * (own / timestep) - 1e-6).astype(int)
        substeps = np.diff(ends, prepend=0).tolist()
        mujoco.mj_setState(self.model, self.data, initial, FULL_STATE)
        self.model.opt.timestep = timestep
        try:
            begun = time.perf_counter()
            for k, control in enumerate(controls):
                steps = substeps[k % len(substeps)]
                if walkers is not None:
                    walkers.advance(steps * timestep, *self.qpos[:2].tolist())
                    self.walker_centers[:] = walkers.touchable
                self.ctrl[:] = control
                self.step(steps)
            seconds = time.perf_counter() - begun
            if reference:
                check_divergence(self.data)
            return seconds, self.pose()
        finally:
            self.model.opt.timestep = own
            self.data.warning.number[:] = warnings
            mujoco.mj_setState(self.model, self.data, present, FULL_STATE)


def _even_part(period: float, longest: float) -> float:
    """Return the largest whole part of a period that is at most `longest`, seconds."""
    return period / math.ceil(period / longest - 1e-9)


def is_tipped(T_world_base: Pose3) -> bool:
    """Whether a robot tilts by more than 60 deg or lies on its back."""
    return 1 - 2 * (T_world_base.qx * T_world_base.qx + T_world_base.qy * T_world_base.qy) < TIPPED


def _add_contact_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add contact sensors, and position sensors of the wheels.

    MuJoCo's batches provide no contacts otherwise.
    """
    wheels = {*robot.left_wheels, *robot.right_wheels}
    found, point = (
        1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{name}")) for name in ("FOUND", "POS")
    )
    for geom in [geom for geom in spec.geoms if geom.contype]:
        rolls = geom.name in wheels or geom.name.endswith("caster")
        spec.add_sensor(
            name=CONTACT_SENSOR + geom.name,
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=geom.name,
            intprm=[found | point, 0, WHEEL_CONTACTS] if rolls else [found, 0, 1],
        )
        if rolls:
            spec.add_sensor(
                name=CENTER_SENSOR + geom.name,
                type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
                objtype=mujoco.mjtObj.mjOBJ_GEOM,
                objname=geom.name,
            )


DIVERGENCE_WARNINGS = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "a position is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQVEL: "a velocity is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQACC: "an acceleration is not finite or too large",
    mujoco.mjtWarning.mjWARN_INERTIA: "the inertia matrix is singular",
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "there are more contacts than memory for them",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "there are more constraints than memory for them",
}
KINDS: IntArray = np.array([int(kind) for kind in DIVERGENCE_WARNINGS], np.int64)


@dataclass(frozen=True, kw_only=True)
class Collisions:
    """Contact statistics of a run.

    Attributes:
        max_penetration: Deepest penetration of ground or walls, meters; the 1 mm of a loaded tyre counts.
        penetration_p999: 99.9 % quantile of the penetration over the samples, meters.
        body_contacts: Number of collisions: the body touched something, or a wheel a face steeper than the
            robot climbs.
        body_contact_seconds: Duration of the collisions.
        samples: Number of samples, one each control update.
    """

    max_penetration: float
    penetration_p999: float
    body_contacts: int
    body_contact_seconds: float
    samples: int


# A signature for arrays of any layout: a single contact is contiguous in memory, several are not, and the
# first single contact of a drive would wait for the compiler.
@njit("Tuple((f8, b1))(f8[:], i4[:, :], f8[:, :], f8[:, ::1], f8[::1])")
def contact_state(
    distance: FloatArray, pairs: Int32Array, points: FloatArray, centers: FloatArray, drops: FloatArray
) -> tuple[float, bool]:
    """Return the deepest contact of the robot, meters, and whether any is a collision.

    A contact has one geom of the robot and one of ground or walls, in either order.
    """
    depth, touching = 0.0, False
    for k in range(len(distance)):
        for side in range(2):
            geom = pairs[k, side]
            if drops[geom] > -np.inf:
                depth = max(depth, -distance[k])
                touching |= centers[geom, 2] - points[k, 2] < drops[geom]
    return depth, touching


def divergence_message(seconds: float, warned: Int32Array) -> str:
    """Return the message about a divergence, from time and number of warnings of each kind."""
    reasons = [reason for kind, reason in DIVERGENCE_WARNINGS.items() if warned[kind]]
    reason = reasons[0] if reasons else "the state is not finite"
    return f"the simulation diverged at {seconds:.3f} s: {reason}"


def describe_divergence(data: mujoco.MjData) -> str:
    """Return how a simulation has diverged; empty = it has not."""
    if is_sound(data.warning.number, KINDS, data.qpos, data.qvel):
        return ""
    return divergence_message(data.time, data.warning.number)


def check_divergence(data: mujoco.MjData) -> None:
    """Stop a simulation that has diverged."""
    if reason := describe_divergence(data):
        raise SimulationError(reason)


@njit
def is_sound(warned: Int32Array, kinds: IntArray, qpos: FloatArray, qvel: FloatArray) -> bool:
    """Return whether a state is finite and MuJoCo gave none of some warnings (n,)."""
    for kind in kinds:
        if warned[kind]:
            return False
    return bool(is_finite(qpos) and is_finite(qvel))


@njit
def is_finite(values: FloatArray) -> bool:
    """Return whether all of (n,) values are finite."""
    finite = True
    for value in values:  # compiles sooner than np.isfinite(values).all()
        finite &= math.isfinite(value)
    return finite

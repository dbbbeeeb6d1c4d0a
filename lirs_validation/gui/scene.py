"""The 3D scene of a page: the world, the robot, its scans and maps."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import cv2
import mujoco
import numpy as np
import trimesh
import viser
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from lirs_envs.robots.robot import Robot, make_robot
from lirs_validation.gui.controls import without_flags
from lirs_validation.gui.playback import MapSnapshot, Moment
from lirs_validation.report.pictures import with_paths
from lirs_wct import ByteArray, FloatArray, HeightField, Pose3, World
from lirs_wct.drawing.canvas import BLUE, Canvas, bounds_of
from lirs_wct.export.appearance import world_parts
from lirs_wct.geometry import fewer_nodes
from lirs_wct.ground import Terrain
from lirs_wct.meshing.solid import solid_mesh

SIDE = 320
"""Pixels of the longer side of the map."""
PREVIEW_TRIANGLES, BUILT_TRIANGLES = 33_000, 200_000
"""Triangles sent to a browser while controls are moved, and after Build."""
UNSEEN = np.full((8, 8, 3), 205, np.uint8)
"""Picture of an empty map."""
MIN_SCALE = 0.1
"""Smallest error at the upper end of the color scale, meters."""
POINTS = 1500
"""Largest number of drawn path points."""
DRAWN_HEIGHT = 0.15
"""Height of the estimated path and the map above the ground, meters."""
FOOT = 0.5
"""Radius of the ground search around a cell, meters; the cell may be on top of an obstacle."""
WALLS = 20_000
"""Largest number of drawn map cells."""
BEAMS = 120
"""Largest number of drawn beams."""
SCAN, FAN, MARKED = (220, 30, 60), (255, 150, 160), (213, 94, 0)
EVENT = {"show": True, "size": 10, "fill": "#D55E00"}
SERIES: tuple[Any, ...] = (
    {"label": "time [s]"},
    {"label": "ATE [m]", "stroke": "#CC4778", "width": 2},
    {"label": "RTF", "stroke": "#3B9BD9", "scale": "rtf", "width": 1},
    {"label": "event", "stroke": "#D55E00", "scale": "event", "points": EVENT},
)
SCALES: dict[str, Any] = {"x": {"time": False}, "y": {}, "rtf": {}, "event": {"range": (0, 1.1)}}
AXES: tuple[Any, ...] = ({}, {"size": 65}, {"scale": "rtf", "side": 1, "size": 35, "grid": {"show": False}})
LEGEND = (
    "black: occupied, white: free; <b style='color:#0072B2'>true</b> and "
    "<b style='color:#D55E00'>estimated</b> path; north is up, {}<br>its error in the scene: 0 "
    "<span style='background:linear-gradient(90deg,#0d0887,#cc4778,#f0f921);padding:0 1.2em'></span> {:.2f} m"
)
CAMERA_OFFSET = np.array((0.0, -9.0, 7.0))
"""Initial offset of the camera from the robot, meters."""
TURNING = 2.0
"""Seconds during which the browser may still report the old camera pose."""

TEXTURE = 1024
"""Largest side of a texture, pixels; smaller in previews, for speed."""
PREVIEW_TEXTURE = 384
VISUAL = 2
"""Group of the visible geoms."""
SECTIONS = 20
"""Sections of cylinders, capsules and spheres."""


class WorldScene:
    """The world of a page."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._bounds: tuple[float, ...] | None = None
        self._world: viser.GlbHandle | None = None
        client.scene.set_up_direction("+z")
        client.scene.configure_default_lights(True, cast_shadow=False)

    def show_world(self, world: World, *, coarse: bool) -> int:
        """Show a world instead of the last one; return its number of triangles."""
        limits = (PREVIEW_TRIANGLES, PREVIEW_TEXTURE) if coarse else (BUILT_TRIANGLES, TEXTURE)
        content, triangles = world_glb(world, *limits)
        self._world = self._client.scene.add_glb("/world", content)
        if world.surface.bounds != self._bounds:  # else the user's view stays
            self._look_at(world)
        return triangles

    def mark(self, name: str, point: tuple[float, float], world: World) -> None:
        """Mark a clicked place of the ground."""
        position = (*point, float(world.surface.height_at(*point)))
        ball = self._client.scene.add_icosphere(f"/mark/{name}", 0.2, MARKED, position=position)
        self._client.scene.add_label(f"{ball.name}/label", name, anchor="bottom-center")

    def unmark(self) -> None:
        """Remove the marks."""
        self._client.scene.remove_by_name("/mark")

    def clear(self) -> None:
        """Show no world."""
        if self._world is not None:
            self._world.remove()
        self._world = self._bounds = None

    def _look_at(self, world: World) -> None:
        """Show the whole world."""
        self._bounds = west, south, east, north = world.surface.bounds
        middle = np.array(((west + east) / 2, (south + north) / 2, float(np.median(world.surface.z))))
        span = max(east - west, north - south)
        camera = self._client.camera
        with self._client.atomic():
            camera.near, camera.far = span / 2000, 20 * span
            away = span * max(1.0, 1.0 / camera.aspect)  # the whole width, also on a phone
            camera.position = tuple(middle + away * np.array((0.0, -0.85, 0.65)))
            camera.look_at = tuple(middle)
            self._add_scale(west, south, east, north, float(world.surface.z.min()))

    def _add_scale(self, west: float, south: float, east: float, north: float, low: float) -> None:
        """Show a grid around the world, a scale bar and an arrow to the north."""
        scene, span = self._client.scene, max(east - west, north - south)
        unit, gap = round_length(span / 5), 0.04 * span
        scene.add_grid(
            "/scale/grid",
            *(2 * span, 2 * span),
            cell_size=unit,
            section_size=unit,
            position=((west + east) / 2, (south + north) / 2, low - 0.01 * span),
            fade_distance=3 * span,
        )
        bar = [(west, south - gap, low), (west + unit, south - gap, low)]
        _add_path(scene, "/scale/bar", np.array(bar), np.array(MARKED))
        scene.add_label("/scale/length", f"{unit:g} m", position=bar[1], anchor="center-left")
        tip = east + gap, north, low
        arrow = np.array([[(east + gap, north - unit, low), tip]], np.float32)
        shaft, head = unit / 40, unit / 15
        scene.add_arrows(
            "/scale/north", arrow, MARKED, shaft_radius=shaft, head_radius=head, head_length=unit / 5
        )
        scene.add_label("/scale/n", "N", position=tip, anchor="bottom-center")


class DriveScene:
    """Display of a drive's moments, with the map in a separate panel."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._surface: HeightField | None = None
        self._root: viser.FrameHandle | None = None
        self._robot: viser.FrameHandle | None = None
        self._map: MapSnapshot | None = None
        self._canvas: Canvas | None = None
        self._verdict: viser.NotificationHandle | None = None
        self._cells = np.empty((0, 0, 3))
        gui = client.gui
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Map", viser.Icon.MAP):
            self._picture = gui.add_image(UNSEEN, format="png", visible=False)
            self._legend = gui.add_markdown("")
            empty = (np.zeros(1),) * len(SERIES)
            self._chart = gui.add_uplot(empty, SERIES, axes=AXES, scales=SCALES, height=190, visible=False)
            self._marks = gui.add_markdown("")
        self._panel.set_width(280)
        self._panel.dock_left()
        self.follow, self._turning_until = False, 0.0

    def begin(self, robot: str, world: World | None) -> None:
        """Show another drive."""
        self.clear()
        self._surface = None if world is None else world.surface
        scene = self._client.scene
        self._root = scene.add_frame("/drive", show_axes=False)
        self._robot = scene.add_frame("/drive/robot", show_axes=False)
        scene.add_glb("/drive/robot/shape", robot_glb(make_robot(robot)))
        self._panel.visible = True

    def clear(self) -> None:
        """Remove the drive from the scene."""
        if self._root is not None:
            self._root.remove()
        if self._verdict is not None:
            self._verdict.remove()
        self._root = self._robot = self._map = self._canvas = self._verdict = None
        self._panel.visible = self._chart.visible = False

    def approach(self, position: FloatArray) -> None:
        """Look at a place from the south; north is up, as in the map."""
        self._turning_until = time.monotonic() + TURNING
        self._look_at(position, CAMERA_OFFSET)

    def show_course(self, curve: FloatArray, marks: Sequence[tuple[float, str]]) -> None:
        """Show error and real-time factor over time, and events."""
        self._marks.content = ", ".join(f"{name} at {time:.0f} s" for time, name in marks)
        if len(curve) < 2:
            return
        events = np.array([time for time, _ in marks])
        times = np.union1d(curve[:, 0], events)
        ate, rtf = (np.interp(times, curve[:, 0], column) for column in curve[:, 1:].T)
        self._chart.data = times, ate, rtf, np.where(np.isin(times, events), 1.0, np.nan)
        self._chart.visible = True

    def show(self, moment: Moment) -> None:
        """Show a moment."""
        if self._robot is None:
            return
        T, scene = moment.T_world_base, self._client.scene
        with self._client.atomic():
            self._robot.position, self._robot.wxyz = T.position, T.quaternion
            scene.add_point_cloud(
                "/drive/scan", moment.scan, SCAN, point_size=0.07, point_shape="circle", precision="float32"
            )
            ends = moment.scan[:: max(1, -(-len(moment.scan) // BEAMS))]
            beams = np.stack((np.broadcast_to(moment.lidar, ends.shape), ends), axis=1).astype(np.float32)
            scene.add_line_segments("/drive/fan", beams, FAN, thickness=1.0, thickness_units="screen")
            lifted = moment.truth + np.array((0.0, 0.0, DRAWN_HEIGHT))
            _add_path(scene, "/drive/truth", lifted, np.array([int(255 * v) for v in to_rgb(BLUE)]))
            on_ground = self._on_ground(moment.estimate, T.z)
            _add_path(scene, "/drive/estimate", on_ground, error_colors(moment.errors))
            self._take_map(moment.map)
            if self.follow:  # from the user's chosen distance and direction
                camera, turning = self._client.camera, time.monotonic() < self._turning_until
                self._look_at(T.position, CAMERA_OFFSET if turning else camera.position - camera.look_at)
        self._picture.visible, size = self._canvas is not None, "nothing is mapped"
        if self._canvas is not None:
            west, south, east, north = self._canvas.bounds
            size = f"{east - west:.0f} x {north - south:.0f} m"
            self._picture.image = with_paths(self._cells, self._canvas, moment.truth[:, :2], moment.estimate)
        self._legend.content = LEGEND.format(size, error_scale(moment.errors))
        title, verdict = without_flags(moment.verdict).split(": ", 1)
        if self._verdict is None:  # stays visible over the scene
            self._verdict = self._client.add_notification(title, verdict, with_close_button=False)
        self._verdict.title, self._verdict.body = title, verdict

    def _take_map(self, snapshot: MapSnapshot | None) -> None:
        """Show the walls of another map, and keep its picture."""
        if snapshot is self._map:
            return
        self._map, self._canvas, walls = snapshot, None, np.empty((0, 2))
        if snapshot is not None:
            grid = snapshot.grid
            walls, bounds = grid.occupied_points(), bounds_of(grid)
            if bounds is not None:
                self._canvas = Canvas.over(bounds, SIDE)
                self._cells = self._canvas.grid_picture(grid)
        walls = walls[:: max(1, -(-len(walls) // WALLS))]
        around = [(0.0, 0.0), (FOOT, 0.0), (-FOOT, 0.0), (0.0, FOOT), (0.0, -FOOT)]
        lowest = np.min([self._on_ground(walls + np.array(shift), 0.0)[:, 2] for shift in around], axis=0)
        points = np.column_stack((walls, lowest)).astype(np.float32)
        style: dict[str, Any] = {"point_size": 0.06, "precision": "float32"}
        self._client.scene.add_point_cloud("/drive/walls", points, (20, 20, 24), **style)

    def _on_ground(self, points: FloatArray, otherwise: float) -> FloatArray:
        """Return points (n, 3) slightly above the ground, or above `otherwise` without ground."""
        z = np.full(len(points), np.nan)
        if self._surface is not None:
            z = self._surface.height_at(points[:, 0], points[:, 1])
        return np.column_stack((points, np.where(np.isfinite(z), z, otherwise) + DRAWN_HEIGHT))

    def _look_at(self, position: FloatArray, away: FloatArray) -> None:
        camera = self._client.camera
        with self._client.atomic():
            camera.position, camera.look_at = position + away, position


def round_length(length: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... meters up to a length, also below 1."""
    power = 10.0 ** math.floor(math.log10(length))
    return power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= length)


def error_scale(errors: FloatArray) -> float:
    """Return the error at the upper end of the color scale, meters."""
    return max(MIN_SCALE, float(errors.max()))


def error_colors(errors: FloatArray) -> ByteArray:
    """Return (k, 3) RGB colors of errors: dark violet for 0, yellow for the largest."""
    levels = np.clip(255 * errors / error_scale(errors), 0, 255).astype(np.uint8)
    colors: ByteArray = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_PLASMA)[:, 0, ::-1]
    return colors


def ground_point(surface: HeightField, origin: ArrayLike, direction: ArrayLike) -> tuple[float, float] | None:
    """Return x, y where a ray first meets the ground; None if it misses."""
    begin, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    west, south, east, north = surface.bounds
    middle = (west + east) / 2, (south + north) / 2, float(surface.z.min())
    reach = float(np.linalg.norm(begin - middle)) + math.hypot(east - west, north - south)
    steps = np.arange(0.0, reach, min(surface.cell) / 2)
    points = begin + steps[:, None] * along
    below = np.flatnonzero(points[:, 2] <= surface.height_at(points[:, 0], points[:, 1]))
    if len(below) == 0 or below[0] == 0:
        return None
    x, y = points[below[0], :2].tolist()
    return round(x, 2), round(y, 2)


def _add_path(scene: viser.SceneApi, name: str, points: FloatArray, color: np.ndarray[Any, Any]) -> None:
    """Show a path in one color (3,), or one for each point (n, 3)."""
    few = points[:: max(1, -(-len(points) // POINTS))]
    if len(few) < 2:
        scene.remove_by_name(name)
        return
    segments, tint = np.stack((few[:-1], few[1:]), axis=1).astype(np.float32), color.astype(np.uint8)
    if color.ndim == 2:  # the browser takes colors of points as linear, and one color as sRGB
        linear = 255.0 * (color[:: max(1, -(-len(points) // POINTS))] / 255.0) ** 2.2
        tint = np.stack((linear[:-1], linear[1:]), axis=1).astype(np.uint8)
    scene.add_line_segments(name, segments, tint, thickness=3.0, thickness_units="screen")


def world_glb(world: World, most: int, texture: int = TEXTURE) -> tuple[bytes, int]:
    """Return a world as GLB, z up, and its number of triangles.

    A surface of more than `most` triangles is shown on a coarser grid; a texture has at most `texture` pixels
    along its longer side.
    """
    rows, cols = world.surface.shape
    if isinstance(world.ground, Terrain) and not world.export_options.limited:
        fits = 2 * rows * cols <= most
    else:
        fits = len(world.mesh.faces) <= most or world.walls is not None or world.overhangs
    surface = world.mesh if fits else solid_mesh(fewer_nodes(world.surface, int((most / 2) ** 0.5)))
    shown, count = trimesh.Scene(), 0
    for part in world_parts(world, surface):
        mesh, picture = part.mesh, Image.fromarray(part.wear.pixels(world)[..., ::-1])
        picture.thumbnail((texture, texture))
        material = PBRMaterial(baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0)
        visual = TextureVisuals(uv=mesh.uv, material=material)
        shape = trimesh.Trimesh(
            mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False, visual=visual
        )
        shown.add_geometry(shape, geom_name=part.wear.name)
        count += len(mesh.faces)
    content: bytes = shown.export(file_type="glb")
    return content, count


def robot_glb(robot: Robot) -> bytes:
    """Return the robot at rest, base_link at the origin, x ahead."""
    model = mujoco.MjModel.from_xml_path(str(robot.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = model.body("base_link").id
    T_base_world = Pose3.from_arrays(data.xpos[base], data.xquat[base]).inverse()
    scene = trimesh.Scene()
    for geom in np.flatnonzero(model.geom_group == VISUAL).tolist():
        shape = _shape(int(model.geom_type[geom]), model.geom_size[geom].tolist())
        if shape is None:
            continue
        placed = np.eye(4)
        placed[:3, :3] = T_base_world.rotation @ data.geom_xmat[geom].reshape(3, 3)
        placed[:3, 3] = T_base_world.apply(data.geom_xpos[geom])
        shape.apply_transform(placed)
        color = (255 * model.geom_rgba[geom]).astype(np.uint8)
        material = PBRMaterial(baseColorFactor=color, metallicFactor=0.1, roughnessFactor=0.7)
        shape.visual = TextureVisuals(uv=np.zeros((len(shape.vertices), 2)), material=material)
        scene.add_geometry(shape)
    content: bytes = scene.export(file_type="glb")
    return content


def _shape(kind: int, size: list[float]) -> trimesh.Trimesh | None:
    a, b, c = size
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = trimesh.creation.box(extents=(2 * a, 2 * b, 2 * c))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape = trimesh.creation.cylinder(radius=a, height=2 * b, sections=SECTIONS)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shape = trimesh.creation.capsule(radius=a, height=2 * b, count=(SECTIONS, SECTIONS))
    elif kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        shape = trimesh.creation.uv_sphere(radius=1.0, count=(SECTIONS // 2, SECTIONS))
        shape.apply_scale((a, a, a) if kind == mujoco.mjtGeom.mjGEOM_SPHERE else (a, b, c))
    else:
        return None
    shape.unmerge_vertices()  # flat shading shows the edges
    return shape

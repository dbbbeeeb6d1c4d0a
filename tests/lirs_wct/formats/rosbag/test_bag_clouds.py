"""Point clouds of bags: layouts of several drivers, invalid points, damaged messages."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import write_bag
from lirs_wct.geometry.scan import PointCloud
from tests.lirs_wct.formats.rosbag import drives

CODES = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}
KIND = "sensor_msgs/msg/PointCloud2"
STAMP = 1_700_000_000.0
XYZ = np.array([(1, 2, 3), (np.nan, 0, 0), (0, 0, 0), (-4, 5, 0.5), (6, 7, 8), (9, 1, 2)], np.float32)
VALID = XYZ[[0, 3, 4, 5]]
SECONDS = np.array((0.0, 0.02, 0.04, 0.06, 0.08, 0.1))
CLOUDS = Topics(clouds=True, others="hector")


def message(store: Any, dtype: Any, time: Any = None, *, rows: int = 1, pad: int = 0) -> Any:
    """Return XYZ as a cloud with the fields of a dtype, in rows with `pad` unused bytes at their ends."""
    points = np.zeros(len(XYZ), dtype)
    for k, axis in enumerate("xyz"):
        points[axis] = XYZ[:, k]
    if "ring" in points.dtype.names:
        points["ring"] = np.arange(len(XYZ))
    if time is not None:
        points[time[0]] = time[1]
    table = points.view(np.uint8).reshape(rows, -1)
    data = np.pad(table, ((0, 0), (0, pad)), constant_values=7).ravel()
    field = store.types["sensor_msgs/msg/PointField"]
    fields = [field(n, at, CODES[kind.str[1:]], 1) for n, (kind, at) in points.dtype.fields.items()]
    sec, nanosec = divmod(round(STAMP * 1e9), 1_000_000_000)
    stamp = store.types["builtin_interfaces/msg/Time"](sec, nanosec)
    frame = {"seq": 0} if "seq" in store.types["std_msgs/msg/Header"].__annotations__ else {}
    header = store.types["std_msgs/msg/Header"](**frame, stamp=stamp, frame_id="lidar")
    big = points.dtype["x"].str[0] == ">"
    step, width = points.dtype.itemsize, len(XYZ) // rows
    return store.types[KIND](header, rows, width, fields, big, step, table.shape[1] + pad, data, False)


def clouds(path: Path, *messages: Any, store: Any, ros1: bool = False) -> list[PointCloud]:
    writer: Any = (
        rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    )
    with writer:
        connection = writer.add_connection("/points", KIND, typestore=store)
        for k, m in enumerate(messages):
            m.header.stamp.sec += k
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connection, k, serialize(m, KIND))
    log = read_bag(path, CLOUDS)
    return list(log.clouds)


VELODYNE = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2"), ("time", "<f4")]
OUSTER = np.dtype(
    {
        "names": ["x", "y", "z", "t", "ring"],
        "formats": ["<f4", "<f4", "<f4", "<u4", "u1"],
        "offsets": [0, 4, 8, 20, 26],
        "itemsize": 48,
    }
)
HESAI = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("timestamp", "<f8"), ("ring", "<u2")]
BIG = [("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("offset_time", ">u4"), ("ring", ">u2")]
LAYOUTS: dict[str, tuple[Any, Any, dict[str, int], float]] = {
    "seconds": (VELODYNE, ("time", SECONDS), {}, 0.0),
    "seconds up to the stamp": (VELODYNE, ("time", SECONDS - 0.1), {}, -0.1),
    "nanoseconds, organized, padded": (OUSTER, ("t", SECONDS * 1e9), {"rows": 2, "pad": 16}, 0.0),
    "a clock's seconds": (HESAI, ("timestamp", STAMP + SECONDS), {}, 0.0),
    "a clock's nanoseconds": (HESAI, ("timestamp", (STAMP + SECONDS) * 1e9), {}, 0.0),
    "another clock's seconds": (HESAI, ("timestamp", 5e6 + SECONDS), {"rows": 3}, 0.0),
    "big-endian": (BIG, ("offset_time", SECONDS * 1e9), {"rows": 2}, 0.0),
}


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("case", LAYOUTS)
def test_clouds_of_drivers_are_read(tmp_path: Path, case: str, ros1: bool) -> None:
    dtype, time, shape, start = LAYOUTS[case]
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    made = [message(store, dtype, time, **shape) for _ in range(2)]
    if case.startswith("a clock"):
        made = made[:1]
    found = clouds(tmp_path / "run.bag" if ros1 else tmp_path / "run", *made, store=store, ros1=ros1)
    assert len(found) == len(made)
    for k, cloud in enumerate(found):
        np.testing.assert_array_equal(cloud.xyz, VALID)
        np.testing.assert_array_equal(cloud.ring, (0, 3, 4, 5))
        np.testing.assert_allclose(cloud.time, SECONDS[[0, 3, 4, 5]], atol=1e-6)
        assert cloud.stamp == pytest.approx(STAMP + k + start, abs=1e-6)


def test_clouds_without_time_and_ring_are_read(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    (cloud,) = clouds(tmp_path / "run", message(store, VELODYNE[:3]), store=store)
    np.testing.assert_array_equal(cloud.xyz, VALID)
    assert not cloud.time.any()
    assert not cloud.rolling


def test_short_clouds_and_clouds_without_z_are_left_out(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    good, short, flat = (message(store, VELODYNE) for _ in range(3))
    short.data = short.data[:-1]
    flat.fields = [field for field in flat.fields if field.name != "z"]
    (cloud,) = clouds(tmp_path / "some", short, flat, good, store=store)
    assert cloud.stamp == pytest.approx(STAMP + 2)
    log = read_bag(tmp_path / "some", CLOUDS)
    assert (log.left_out, len(log.stamps)) == (2, 1)
    with pytest.raises(SourceError, match=r"none: holds no point cloud that can be used \(1 x cloud without"):
        clouds(tmp_path / "none", short, store=store)


def test_bags_of_the_other_kind_name_the_mappers_that_fit(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    clouds(tmp_path / "run", message(store, VELODYNE), store=store)
    with pytest.raises(
        SourceError, match=r"run: holds no topic of laser scans; --mapper kiss-icp read.*/points \(sensor"
    ):
        read_bag(tmp_path / "run", Topics(others="kiss-icp"))


def test_organized_clouds_keep_their_columns_and_intensities(tmp_path: Path) -> None:
    given = drives.drive()
    write_bag(tmp_path / "bag", given)
    log = read_bag(tmp_path / "bag", CLOUDS)
    for read, tick in zip(log.clouds, given.ticks, strict=True):
        assert read.shape == (4, 3)
        assert read.stamp == pytest.approx(tick.cloud.stamp, abs=1e-9)
        np.testing.assert_allclose(read.T_base_laser.position, drives.MOUNT.position)
        np.testing.assert_array_equal(read.records(), tick.cloud.records())
        np.testing.assert_array_equal(read.column, tick.cloud.column)

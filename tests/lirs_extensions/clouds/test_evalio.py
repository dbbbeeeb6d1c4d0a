"""Pipelines of evalio behind `CloudMapper`, with a fake extension."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_extensions.clouds.evalio import PIPELINES, EvalioConfig
from lirs_extensions.clouds.packages import TimedOdometry
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import ImuReadings, PointCloud, Pose3
from slam_baselines.mapper import CLOUD_MAPPERS, make_cloud_mapper

TYPES = """
import numpy as np
class Made:
    def __init__(self, *args, **kw): self.args, self.__dict__ = args, {**self.__dict__, "args": args, **kw}
class LidarParams(Made): pass
class ImuParams(Made): pass
class ImuMeasurement(Made): pass
class Stamp:
    @staticmethod
    def from_sec(sec): return sec
class SE3:
    def __init__(self, matrix): self.matrix = matrix
    @staticmethod
    def from_mat(matrix): return SE3(np.array(matrix))
    def to_mat(self): return self.matrix
"""
HELPERS = """
import numpy as np
from enum import Enum
class DataType(Enum): FLOAT32, UINT16 = 7, 4
class Field:
    def __init__(self, **kw): self.__dict__.update(kw)
class PointCloudMetadata(Field): pass
class Measurement: pass
def pc2_to_evalio(about, fields, data):
    kinds = {DataType.FLOAT32: "<f4", DataType.UINT16: "<u2"}
    named = {"names": [f.name for f in fields], "formats": [kinds[f.datatype] for f in fields]}
    named |= {"offsets": [f.offset for f in fields], "itemsize": about.point_step}
    made = Measurement()
    made.points, made.stamp = np.frombuffer(data, np.dtype(named)), about.stamp
    assert len(made.points) == about.width * about.height
    return made
def fill_col_row_major(measurement): measurement.filled = True
"""
PIPELINE = """
import numpy as np
from evalio._cpp.types import SE3
class Fake:
    made = []
    def __init__(self):
        Fake.made.append(self)
        self.calls, self.saved = [], []
    @staticmethod
    def default_params(): return {"num_threads": 0, "voxel_size": 1.0}
    def __getattr__(self, name):
        if not name.startswith(("set_", "initialize", "add_imu")): raise AttributeError(name)
        return lambda *given: self.calls.append((name, *given))
    def add_lidar(self, measurement):
        self.calls.append(("add_lidar", measurement))
        matrix = np.eye(4)
        matrix[0, 3] = measurement.stamp + {shift}
        self.saved.append((measurement.stamp, SE3(matrix)))
    def saved_estimates(self):
        saved, self.saved = self.saved, []
        return saved
"""


@pytest.fixture
def evalio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A package whose own module cannot be imported, with an extension that records its calls."""
    folder = tmp_path / "evalio" / "_cpp"
    folder.mkdir(parents=True)
    (tmp_path / "evalio" / "__init__.py").write_text("import tqdm_that_is_not_there")
    (folder / "__init__.py").write_text("from . import types, helpers, pipelines")
    (folder / "types.py").write_text(TYPES)
    (folder / "helpers.py").write_text(HELPERS)
    classes = [f"class {kind.type}(Fake): pass" for kind in PIPELINES.values()]
    (folder / "pipelines.py").write_text(PIPELINE.replace("{shift}", "0.05") + "\n".join(classes))
    for name in [name for name in sys.modules if name.partition(".")[0] == "evalio"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    yield lambda: sys.modules["evalio._cpp.pipelines"].Fake.made[-1]
    for name in [name for name in sys.modules if name.partition(".")[0] == "evalio"]:
        del sys.modules[name]


def sweep(stamp: float, *, rolling: bool = True, organized: bool = True) -> PointCloud:
    column = np.array([0, 3, 9], np.uint16)
    time = column.astype(np.float32) / 90 if rolling else np.zeros(3, np.float32)
    xyz, ring = np.arange(9, dtype=np.float32).reshape(3, 3), np.array([0, 0, 1], np.uint16)
    cloud = PointCloud(xyz, ring, time, stamp, Pose3(0.1, 0, 0.3))
    if not organized:
        return cloud
    intensity = np.array([1, 2, 3], np.float32)
    return PointCloud(xyz, ring, time, stamp, Pose3(0.1, 0, 0.3), intensity, column, (2, 10))


def readings(stamp: float) -> ImuReadings:
    stamps = stamp + 0.005 * np.arange(-19, 1) if stamp else np.empty(0)
    n = len(stamps)
    return ImuReadings(stamps, np.full((n, 3), 0.1), np.full((n, 3), 9.8), 0.02, 0.3)


def called(pipeline: Any, name: str) -> list[Any]:
    return [given for call, *given in pipeline.calls if call == name]


@pytest.mark.parametrize("name", list(PIPELINES))
def test_a_sweep_becomes_one_array(name: str, evalio: Any) -> None:
    kind = PIPELINES[name]
    mapper = make_cloud_mapper(f"evalio:{name}")
    assert isinstance(mapper, TimedOdometry)
    for k in range(6):
        mapper.update(sweep(0.1 * k), None, readings(0.1 * k))
    ((measurement,), *_) = called(evalio(), "add_lidar")
    points = measurement.points
    if kind.organized:
        assert points.shape == (20,)
        assert np.isnan(points["x"]).sum() == 17
        points = points[np.isfinite(points["x"])]
    np.testing.assert_array_equal(points["y"], (1, 4, 7))
    np.testing.assert_array_equal(points["ring"], (0, 0, 1))
    np.testing.assert_array_equal(points["intensity"], (1, 2, 3))
    np.testing.assert_allclose(points["time"], (0, 1 / 30, 0.1), atol=1e-7)
    ((lidar,),) = called(evalio(), "set_lidar_params")
    assert (lidar.num_rows, lidar.num_columns, lidar.rate) == (2, 10, 10)
    ((mount,),) = called(evalio(), "set_imu_T_lidar")
    np.testing.assert_array_equal(mount.matrix[:3, 3], (0.1, 0, 0.3))
    assert mapper.stats.skipped == ({"after the last reading": 1} if kind.inertial else {})


@pytest.mark.parametrize("name", list(PIPELINES))
def test_poses_are_those_at_the_stamps(name: str, evalio: Any) -> None:
    """The fake drives at 1 m/s, and knows the pose of a sweep's middle."""
    mapper = make_cloud_mapper(f"evalio:{name}")
    for k in range(20):
        mapper.update(sweep(0.1 * k), None, *([readings(0.1 * k)] * PIPELINES[name].inertial))
    gone = np.diff(mapper.trajectory().positions[4:, 0])
    np.testing.assert_allclose(gone, 0.1, atol=1e-6)
    # evalio's stamp is the sweep's; ct and liosam are taken at its start, liosam two sweeps later.
    system = mapper._system  # type: ignore[attr-defined]
    late = {"ct": 0.0, "liosam": -0.2}.get(name, 0.05)
    for k in (-2, -1, 0):
        ((time, _),) = system.register(sweep(7.0 + 0.1 * k))
    assert time == pytest.approx(7.0 + late)


def test_an_inertial_pipeline_gets_readings_and_their_densities(evalio: Any) -> None:
    mapper = make_cloud_mapper("evalio:dlio", inertial_rate=100.0)
    for k in range(4):
        mapper.update(sweep(0.1 * k), None, readings(0.1 * k))  # type: ignore[call-arg]
    ((noise,),) = called(evalio(), "set_imu_params")
    assert (noise.gyro, noise.accel, noise.rate) == (pytest.approx(0.002), pytest.approx(0.03), 100.0)
    order = [call for call, *_ in evalio().calls]
    assert order.index("initialize") < order.index("add_imu") < order.index("add_lidar")
    stamps = [given[0].args[0] for given in called(evalio(), "add_imu")]
    np.testing.assert_allclose(np.diff(stamps), 0.005, atol=1e-9)
    assert len(stamps) == 60


def test_parameters_are_evalios_with_one_thread(evalio: Any) -> None:
    make_cloud_mapper("evalio:mad", parameters={"voxel_size": 0.5})
    assert called(evalio(), "set_params") == [[{"num_threads": 1, "voxel_size": 0.5}]]
    with pytest.raises(ConfigError, match="unknown parameter of evalio:mad 'voxels'; legal: num_threads"):
        make_cloud_mapper("evalio:mad", parameters={"voxels": 0.5})
    with pytest.raises(ConfigError, match="rate of evalio:mad must be a finite number above 0"):
        make_cloud_mapper("evalio:mad", rate=0.0)
    with pytest.raises(ConfigError, match="unknown pipeline of evalio 'icp'; legal: ct, dlio"):
        EvalioConfig(pipeline="icp")


@pytest.mark.parametrize("name", ["ct", "kiss"])
def test_a_sweep_at_one_instant_is_refused_where_it_would_end_the_process(name: str, evalio: Any) -> None:
    mapper = make_cloud_mapper(f"evalio:{name}")
    with pytest.raises(ConfigError, match=rf"^evalio:{name} needs rolling sweeps \(option scan-time\)$"):
        mapper.update(sweep(0.0, rolling=False), None)


def test_an_unorganized_cloud_is_refused_where_it_would_end_the_process(evalio: Any) -> None:
    with pytest.raises(ConfigError, match="the cloud is not organized"):
        make_cloud_mapper("evalio:loam").update(sweep(0.0, organized=False), None)
    make_cloud_mapper("evalio:genz").update(sweep(0.0, organized=False), None)
    assert called(evalio(), "add_lidar")


def test_each_pipeline_is_a_mapper() -> None:
    named = {name.partition(":")[2] for name in CLOUD_MAPPERS if name.startswith("evalio:")}
    assert named == set(PIPELINES)
    for name, kind in PIPELINES.items():
        needs = CLOUD_MAPPERS[f"evalio:{name}"].needs
        expected = kind.rolling, kind.organized, kind.inertial
        assert ("rolling" in needs, "organized" in needs, "inertial" in needs) == expected

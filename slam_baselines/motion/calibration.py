"""Calibration of the odometry: estimation of its systematic errors while driving.

Wheels of unequal size, a wrong track, or a displaced laser cause the same error in every step. An unbiased
prior needs their correction, which is linear in the distance traveled and the angle turned. Recursive least
squares estimates it from the poses that scan matching confirms. Forgetting is directional (Cao and Schwartz
2000, "A directional forgetting algorithm based on the decomposition of the information matrix", Automatica
36, Eqs. 21-23): a step replaces older ones of its kind only. Minutes of driving in circles do not inform
about straight steps, and plain exponential forgetting would let the covariance of unobserved directions grow
without bound.

Wheels that skid in a turn have no friction left, so on a slope the robot slides downhill as well: by a
distance per radian turned and unit of slope. That is one more gain, estimated in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import Pose2, wrap_angle

Slope = tuple[float, float]
"""Descent of the ground per meter ahead and per meter to the left."""
LEVEL: Slope = (0.0, 0.0)
UNTOLD = 1e-100
"""Information below which a step replaces none, since its square underflows."""


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Checked, of="the calibration"):
    """Prior and noise of the correction, which set its rate of learning.

    Attributes:
        per_meter: standard deviation of the correction per meter before anything is known (m/m, rad/m).
        per_radian: the same per radian turned (m/rad, rad/rad).
        noise: of the correction observed in one step, meters and radians.
        memory: steps of one kind after which an observation of that kind counts 1/e.
        slide: standard deviation of the slide before anything is known, meters per radian and unit of slope.
        slide_noise: of the slide observed in one step, meters.
    """

    per_meter: float = limited(0.05, "(0, inf]")
    per_radian: float = limited(0.05, "(0, inf]")
    noise: float = limited(0.02, "(0, inf]")
    memory: float = limited(500.0, "(0, inf]")
    slide: float = limited(2.0, "(0, inf]")
    slide_noise: float = limited(0.007, "(0, inf]")


class Calibration:
    """Correction of odometry's steps, learned from the registered poses.

    Attributes:
        gain: correction of x, y, yaw per meter ahead and per radian: xx, xt, yx, yt, tx, tt.
        slide: meters downhill per radian turned, either way, and unit of slope.
    """

    def __init__(self, config: CalibrationConfig) -> None:
        self.gain = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        self.slide = 0.0
        self._prior = 1 / config.per_meter**2, 1 / config.per_radian**2
        self._information = 0.0, 0.0, 0.0
        self._noise = config.noise**2
        self._keep = math.exp(-1 / config.memory)
        self._slide_start = self._slide_variance = config.slide**2
        self._slide_noise = config.slide_noise**2

    @property
    def covariance(self) -> tuple[float, float, float]:
        """Covariance of each row of the gain: per meter^2, per meter and radian, per radian^2."""
        p, q, r = self._information
        p, r = p + self._prior[0], r + self._prior[1]
        determinant = p * r - q * q
        return r / determinant, -q / determinant, p / determinant

    def correct(self, step: Pose2, down: Slope = LEVEL) -> Pose2:
        """Return the expected step `T_before_now` for an odometry `step` on ground of slope `down`."""
        xx, xt, yx, yt, tx, tt = self.gain
        d, a = step.x, step.yaw
        slide = self.slide * abs(a)
        return Pose2(
            d + xx * d + xt * a + slide * down[0],
            step.y + yx * d + yt * a + slide * down[1],
            wrap_angle(a + tx * d + tt * a),
        )

    def learn(self, step: Pose2, true: Pose2, down: Slope = LEVEL) -> None:
        """Learn from a true step, its odometry `step` and the slope `down` of the ground."""
        d, a = step.x, step.yaw
        c = self.correct(step, down)
        x, y, t = error = true.x - c.x, true.y - c.y, wrap_angle(true.yaw - c.yaw)
        self._observe(d, a)
        p, q, r = self.covariance
        u, v = (p * d + q * a) / self._noise, (q * d + r * a) / self._noise
        xx, xt, yx, yt, tx, tt = self.gain
        self.gain = xx + x * u, xt + x * v, yx + y * u, yt + y * v, tx + t * u, tt + t * v
        self._learn_slide(abs(a) * down[0], abs(a) * down[1], error)

    def _observe(self, d: float, a: float) -> None:
        """Add a step's information in place of older information about such steps.

        The prior knowledge is never forgotten: it bounds the covariance from above.
        """
        p, q, r = self._information
        u, v = p * d + q * a, q * d + r * a
        known = u * d + v * a
        forget = (1 - self._keep) / known if known > UNTOLD else 0.0
        self._information = (
            p - forget * u * u + d * d / self._noise,
            q - forget * u * v + d * a / self._noise,
            r - forget * v * v + a * a / self._noise,
        )

    def _learn_slide(self, u: float, v: float, error: tuple[float, float, float]) -> None:
        """Learn the slide from the error left by a slide of (u, v) per gain."""
        p, total = self._slide_variance, u * u + v * v
        scale = p / (self._slide_noise + p * total)
        self.slide += scale * (u * error[0] + v * error[1])
        self._slide_variance = min((p - scale * total * p) / self._keep, self._slide_start)

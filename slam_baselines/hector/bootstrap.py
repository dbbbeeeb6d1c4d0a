"""Forward registration of the first keyframes in a new map, with calibrated odometry."""

from __future__ import annotations

from dataclasses import replace

from slam_baselines.mapping.bootstrap import register_forwards
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.mapping.map_builder import MapBuilder
from slam_baselines.matching.localizability import LocalizabilityMonitor
from slam_baselines.matching.registration import Registration
from slam_baselines.motion.dead_reckoning import DeadReckoning, OdometryStep, PoseEstimate

HectorKeyframe = Keyframe[tuple[OdometryStep | None, ...]]
"""Keyframe whose motion is that by odometry, scan by scan; None without odometry."""


def refine(
    keyframes: list[HectorKeyframe],
    builder: MapBuilder,
    registration: Registration,
    reckoning: DeadReckoning,
    localizability: LocalizabilityMonitor,
) -> list[HectorKeyframe]:
    """Build the map again from keyframes; return them with their new poses.

    Forwards, since the odometry's calibration makes dead reckoning from the start as good as the walls. If
    too few keyframes fit, no walls are known yet: keyframes and map stay unchanged.

    Args:
        keyframes: all so far.
        builder: of the map.
        registration: of a keyframe in it.
        reckoning: dead reckoning with its present calibration.
        localizability: a new monitor of the keyframes' matches.
    """
    before_refinement = builder.restart()
    found: list[HectorKeyframe] = []

    def register(now: HectorKeyframe, before: HectorKeyframe | None, last: PoseEstimate) -> PoseEstimate:
        estimate = last if before is None else _predict(last, before, now, reckoning)
        slopes = builder.min_slopes(now.scan, estimate.pose, now.height, now.min_slopes)
        if before is not None:
            weights = builder.weights(slopes)
            estimate, match = registration.register(
                builder.pyramid, now.scan.hits, weights, estimate, last.pose
            )
            score, seconds = None if match is None else match.score, now.scan.stamp - before.scan.stamp
            localizability.observe(score, 0.0, seconds)
        builder.enter_again(now.scan, estimate.pose, now.height, slopes)
        found.append(replace(now, pose=estimate.pose, min_slopes=slopes))
        return estimate

    register_forwards(keyframes, register)
    if builder.flat or localizability.localizable:
        return found
    builder.pyramid = before_refinement
    return keyframes


def _predict(
    estimate: PoseEstimate, before: HectorKeyframe, now: HectorKeyframe, reckoning: DeadReckoning
) -> PoseEstimate:
    """Predict the next keyframe by dead reckoning; without odometry, by their first poses."""
    predict, seconds = reckoning.config.predict, now.scan.stamp - before.scan.stamp
    if not now.motion or None in now.motion:
        return predict(estimate, before.pose.inverse() @ now.pose, seconds)
    steps = [(i.correct(reckoning.calibration), i.tilt) for i in now.motion if i is not None]
    return reckoning.config.predict_all(estimate, steps, seconds / len(steps))

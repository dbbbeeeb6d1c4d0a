"""Picture of a twin test: width and distribution of real and simulated residuals."""

from __future__ import annotations

import numpy as np

from lirs_validation.twin.fit import FittedNoise, curve
from lirs_wct.drawing.style import BLUE, VERMILLION, Drawing, new_figure, plain_axes, title

LIMIT = 0.1
"""Largest residual of the picture, meters."""


def residual_figure(fitted: FittedNoise) -> Drawing:
    """Draw the residuals' width over the range, and their distributions."""
    figure = new_figure(9.0, 3.6)
    width, distribution = figure.subplots(1, 2)
    both = (("log", fitted.real, BLUE), ("simulated with noise.yaml", fitted.simulated, VERMILLION))
    bins = np.linspace(-LIMIT, LIMIT, 101)
    for name, sample, color in both:
        rows = curve(sample)
        ranges = [row["range"] for row in rows]
        width.plot(ranges, [1000 * row["width"] for row in rows], "o-", color=color, label=name)
        width.plot(ranges, [1000 * row["bias"] for row in rows], "o:", color=color, markersize=3)
        distribution.hist(
            sample.residual, bins=bins.tolist(), density=True, histtype="step", color=color, label=name
        )
    width.set_ylim(bottom=min(0.0, width.get_ylim()[0]))
    plain_axes(width, "expected range, m", "residuals, mm")
    plain_axes(distribution, "measured less expected range, m", "density, 1/m")
    title(width, "Half the central 68 % (solid), median (dotted)")
    title(distribution, f"Distance of the distributions: {fitted.distance:.3f}")
    width.legend(frameon=False, fontsize=8)
    return figure

"""Picture filters before meshing: denoise, blur, sharpen, remove the stairs of a coarse gray scale.

Values are float32 in any unit.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.geometry.grid_sampling import resample
from lirs_wct.sources.options import BuildOptions

MEDIAN_WINDOW = 5
"""Pixels a side."""
BILATERAL_REACH, BILATERAL_CONTRAST = 3.0, 0.05
"""Standard deviations: pixels, and share of the picture's range."""
ITERATIONS = 40
"""Steps on each level of the pyramid: beyond, the number of triangles hardly falls."""
_COARSEST = 8
_STEP = 1 / 64
"""One over the largest eigenvalue of the squared five-point Laplacian."""


def apply_filters(values: Float32Array, options: BuildOptions) -> Float32Array:
    """Return the values after denoising, smoothing, sharpening and resizing, in this order."""
    if options.denoise is not None:
        values = denoised(values, options.denoise)
    if options.smoothing is not None:
        values = smoothed(values, options.smoothing)
    if options.sharpness is not None:
        values = sharpened(values, options.sharpness, max(options.smoothing or 0.0, 1.0))
    if options.resize is not None:
        values = resample(values, *options.resize)
    return values


def denoised(values: Float32Array, method: Literal["median", "bilateral"]) -> Float32Array:
    """Return values without single wrong pixels (median) or with noise smoothed but edges kept."""
    if method == "median":
        return np.asarray(cv2.medianBlur(values, MEDIAN_WINDOW), dtype=np.float32)
    contrast = max(float(np.ptp(values)) * BILATERAL_CONTRAST, 1e-12)
    return np.asarray(cv2.bilateralFilter(values, -1, contrast, BILATERAL_REACH), dtype=np.float32)


def smoothed(values: Float32Array, sigma: float) -> Float32Array:
    """Return values after a Gaussian blur of `sigma` pixels; the border is continued level."""
    blurred = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, dtype=np.float32)


def sharpened(values: Float32Array, amount: float, sigma: float) -> Float32Array:
    """Return values after an unsharp mask: `amount` times what a blur of `sigma` pixels takes away."""
    sharp: Float32Array = values + np.float32(amount) * (values - smoothed(values, sigma))
    return sharp


def dequantize(levels: Float32Array, step: float = 1.0) -> Float32Array:
    """Return the smoothest surface within half a gray level of every pixel.

    Minimises the thin-plate energy, the sum of squared Laplacians, under |z - levels| <= step / 2 by
    projected gradients with momentum (Beck and Teboulle 2009, algorithm FISTA; restarted after
    O'Donoghue and Candes 2015, section 3.2) from the coarse to the fine: on the coarse levels the wide
    terraces settle.

    Args:
        levels: (rows, cols) gray levels.
        step: between neighboring levels.
    """
    half = np.float32(step / 2)
    pyramid = [levels]
    while min(pyramid[-1].shape) >= 2 * _COARSEST:
        rows, cols = pyramid[-1].shape
        smaller = cv2.resize(pyramid[-1], ((cols + 1) // 2, (rows + 1) // 2), interpolation=cv2.INTER_AREA)
        pyramid.append(np.asarray(smaller, dtype=np.float32))
    z = pyramid[-1]
    for level in reversed(pyramid):
        if z.shape != level.shape:
            z = cv2.resize(z, (level.shape[1], level.shape[0]), interpolation=cv2.INTER_CUBIC)
        z = _smoothest(np.clip(z, level - half, level + half), level - half, level + half)
    return z


def _smoothest(z: Float32Array, low: Float32Array, high: Float32Array) -> Float32Array:
    """Descend from a surface to smoother ones between two bounds."""
    ahead, momentum = z, 1.0
    for _ in range(ITERATIONS):
        gradient = _laplacian(_laplacian(ahead))
        gradient *= -_STEP
        gradient += ahead
        following = np.clip(gradient, low, high, out=gradient)
        moved = following - z
        # Where the step turns against the momentum, the momentum is lost.
        if np.vdot(ahead - following, moved) > 0:
            momentum = 1.0
        after = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        moved *= np.float32((momentum - 1) / after)
        moved += following
        z, ahead, momentum = following, moved, after
    return z


def _laplacian(z: Float32Array) -> Float32Array:
    """Return the five-point Laplacian; the border is continued level."""
    out: Float32Array = cv2.Laplacian(z, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REPLICATE)
    return out

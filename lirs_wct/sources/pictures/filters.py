"""Picture filters before meshing: denoise, blur, sharpen, dequantize gray levels.

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
"""Side of the median filter, pixels."""
BILATERAL_REACH, BILATERAL_CONTRAST = 3.0, 0.05
"""Standard deviations of the bilateral filter: pixels, and share of the picture's range."""
ITERATIONS = 40
"""Steps on each level of the pyramid; more steps hardly reduce the number of triangles."""
_COARSEST = 8
_STEP = 1 / 64
"""One over the largest eigenvalue of the squared five-point Laplacian."""


def apply_filters(values: Float32Array, options: BuildOptions) -> Float32Array:
    """Return the values after denoising, smoothing, sharpening and resizing, in this order."""
    if options.denoise is not None:
        values = denoise(values, options.denoise)
    if options.smoothing is not None:
        values = smooth(values, options.smoothing)
    if options.sharpness is not None:
        values = sharpen(values, options.sharpness, max(options.smoothing or 0.0, 1.0))
    if options.resize is not None:
        values = resample(values, *options.resize)
    return values


def denoise(values: Float32Array, method: Literal["median", "bilateral"]) -> Float32Array:
    """Remove single wrong pixels (median), or smooth noise and keep edges (bilateral)."""
    if method == "median":
        return np.asarray(cv2.medianBlur(values, MEDIAN_WINDOW), dtype=np.float32)
    contrast = max(float(np.ptp(values)) * BILATERAL_CONTRAST, 1e-12)
    return np.asarray(cv2.bilateralFilter(values, -1, contrast, BILATERAL_REACH), dtype=np.float32)


def smooth(values: Float32Array, sigma: float) -> Float32Array:
    """Blur values by a Gaussian of `sigma` pixels; border values are replicated."""
    blurred = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, dtype=np.float32)


def sharpen(values: Float32Array, amount: float, sigma: float) -> Float32Array:
    """Sharpen values by an unsharp mask: add `amount` times the difference to a blur of `sigma` pixels."""
    sharp: Float32Array = values + np.float32(amount) * (values - smooth(values, sigma))
    return sharp


def dequantize(levels: Float32Array, step: float = 1.0) -> Float32Array:
    """Return the smoothest surface within half a gray level of every pixel.

    It minimizes the thin-plate energy, the sum of squared Laplacians, under |z - levels| <= step / 2. The
    method is projected gradients with momentum (Beck and Teboulle 2009, algorithm FISTA; restarted after
    O'Donoghue and Candes 2015, section 3.2), from coarse to fine: wide terraces converge on coarse levels.

    Args:
        levels: (rows, cols) gray levels.
        step: distance of neighboring levels.
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
        # A step against the momentum resets the momentum.
        if np.vdot(ahead - following, moved) > 0:
            momentum = 1.0
        after = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        moved *= np.float32((momentum - 1) / after)
        moved += following
        z, ahead, momentum = following, moved, after
    return z


def _laplacian(z: Float32Array) -> Float32Array:
    """Return the five-point Laplacian; border values are replicated."""
    out: Float32Array = cv2.Laplacian(z, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REPLICATE)
    return out

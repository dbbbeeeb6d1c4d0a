"""What a user may do to a picture before it becomes a terrain; values are float32, any unit."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from lirs_wct.arrays import Float32Array
from lirs_wct.geometry.grid_sampling import resized
from lirs_wct.sources.options import BuildOptions

MEDIAN_WINDOW = 5
"""Pixels a side."""
BILATERAL_REACH, BILATERAL_CONTRAST = 3.0, 0.05
"""Standard deviations: pixels, and share of the picture's range."""


def apply_filters(values: Float32Array, options: BuildOptions) -> Float32Array:
    """Return the values after denoising, smoothing, sharpening and resizing, in this order."""
    if options.denoise is not None:
        values = denoised(values, options.denoise)
    if options.smoothing is not None:
        values = smoothed(values, options.smoothing)
    if options.sharpness is not None:
        values = sharpened(values, options.sharpness, max(options.smoothing or 0.0, 1.0))
    if options.resize is not None:
        values = resized(values, *options.resize)
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

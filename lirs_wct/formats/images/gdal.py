"""Rasters that only GDAL reads, through rasterio (the extra `geo`)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError

EXTRA = "pip install 'lirs-wct[geo]'"


def rasterio_there() -> bool:
    """Whether rasterio can be imported."""
    return find_spec("rasterio") is not None


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a raster; give rasterio's dataset.

    Raises:
        SourceError: rasterio is not there, or cannot read the file.
    """
    try:
        import rasterio
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ImportError:
        raise SourceError(f"{path}: needs the package rasterio: {EXTRA}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            yield dataset
    except RasterioError as error:
        raise SourceError(f"{path}: cannot be read by GDAL: {str(error).splitlines()[0]}") from error


def read_band(dataset: Any) -> NDArray[Any]:
    """Return the first band; what its mask leaves out, and no nodata value says, is NaN."""
    band: NDArray[Any] = dataset.read(1)
    if "per_dataset" in {flag.name for flag in dataset.mask_flag_enums[0]}:
        missing = dataset.read_masks(1) == 0
        if missing.any():
            band = np.where(missing, np.nan, band.astype(np.float64))
    return band

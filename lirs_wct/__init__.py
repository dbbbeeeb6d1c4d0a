"""LIRS-WCT: a picture or a laser map becomes a World.

The names below load on first use, so that reading a value type does not load every format's library.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_wct.errors import WctError
    from lirs_wct.options import BuildOptions
    from lirs_wct.world import World, build_world

__all__ = ["BuildOptions", "WctError", "World", "build_world"]

_HOMES = {"WctError": "errors", "BuildOptions": "options", "World": "world", "build_world": "world"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

"""svprep: exact shadow volumes for any city mesh, prepared once, cached in one file.

import svprep
svprep.build(["city.obj"], "city.svp.h5")
with svprep.open_cache("city.svp.h5") as cache:
    cache.mesh, cache.edges, cache.object_names
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__version__ = "0.1.0"
__all__ = ["__version__", "build", "open_cache", "validate_cache"]

if TYPE_CHECKING:
    from svprep.cache.reader import open_cache
    from svprep.pipeline import build
    from svprep.validate import validate as validate_cache

_HOMES = {
    "build": ("svprep.pipeline", "build"),
    "open_cache": ("svprep.cache.reader", "open_cache"),
    "validate_cache": ("svprep.validate", "validate"),
}


def __getattr__(name: str) -> object:
    """Load what is asked for when it is asked for: ``import svprep`` costs nothing."""
    if name in _HOMES:
        from importlib import import_module

        module, attribute = _HOMES[name]
        return getattr(import_module(module), attribute)
    raise AttributeError(f"module 'svprep' has no attribute {name!r}")

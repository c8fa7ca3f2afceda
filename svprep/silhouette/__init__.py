"""Which edges, in which direction, how many times: the silhouette for any light.

What is named here is loaded when it is first used: a build needs the trees of this package,
and none of its searches.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from svprep.silhouette.query import METHODS, VOLUMES, Method, Volume, silhouette
    from svprep.silhouette.result import Silhouette, Work

__all__ = ["METHODS", "VOLUMES", "Method", "Silhouette", "Volume", "Work", "silhouette"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "result" if name in ("Silhouette", "Work") else "query"
    value = getattr(import_module(f"{__name__}.{module}"), name)
    globals()[name] = value
    return value

"""Which edges, in which direction, how many times: the silhouette for any light."""

from svprep.silhouette.query import METHODS, VOLUMES, Method, Volume, silhouette
from svprep.silhouette.result import Silhouette, Work

__all__ = ["METHODS", "VOLUMES", "Method", "Silhouette", "Volume", "Work", "silhouette"]

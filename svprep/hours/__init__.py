"""How long the sun shines on every surface: `sun_hours`, `trace_points`."""

from svprep.hours.buried import Burial
from svprep.hours.compute import sun_hours, trace_points
from svprep.hours.kinds import Kind
from svprep.hours.result import PointHours, SunHours

__all__ = ["Burial", "Kind", "PointHours", "SunHours", "sun_hours", "trace_points"]

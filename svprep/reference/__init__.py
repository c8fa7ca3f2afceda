"""Plain twins of the fast kernels: short, exact, slow, and obviously right.

Tests compare every kernel with its twin; ``svprep validate --deep`` compares a
whole cache with those that are vectorised. Nothing here is compiled, and
nothing here imports what it judges.

    tables.py    equal rows, welding, edges grouped and written, components, planes
    pairing.py   edges of several faces paired by exact angle
    contact.py   whether two triangles meet, in rational arithmetic
    sums.py      facing, and the multiplicity of every edge from triangles and from records
    volumes.py   how many faces shade a point, from triangles and from volumes

and of silhouettes, for a light:

    silhouettes.py   every edge record looked at, in float64: the twin of all methods
    edge_lists.py    walking over faces: edge elimination and the edge buffer
    hextree.py       the published index, to compare its work with ours

and of clamped segments:

    casters.py       rays: every face between a point and a light, and whether it is clamped away
    clamping.py      the segments, from every cluster against every caster
"""

from svprep.reference.casters import (
    Between,
    CasterRays,
    casters_between,
    outside_segments,
    segments_before_caster,
    surface_points,
)
from svprep.reference.clamping import TwinSegments, clamp_by_scan
from svprep.reference.contact import triangles_touch
from svprep.reference.edge_lists import edge_buffer, eliminate_edges
from svprep.reference.hextree import Hextree, HextreeVisit, build_hextree, visit_hextree
from svprep.reference.pairing import pair_edges
from svprep.reference.silhouettes import SilhouetteRows, SilhouetteTwin
from svprep.reference.sums import EdgeSums, edge_multiplicity, facing, multiplicity_of_rows
from svprep.reference.tables import (
    check_planes,
    components,
    edge_rows,
    first_equal_row,
    group_edges,
    weld,
)
from svprep.reference.volumes import Counts, closed_count, robust_count, volume_count

__all__ = [
    "Between",
    "CasterRays",
    "Counts",
    "EdgeSums",
    "Hextree",
    "HextreeVisit",
    "SilhouetteRows",
    "SilhouetteTwin",
    "TwinSegments",
    "build_hextree",
    "casters_between",
    "check_planes",
    "clamp_by_scan",
    "closed_count",
    "components",
    "edge_buffer",
    "edge_multiplicity",
    "edge_rows",
    "eliminate_edges",
    "facing",
    "first_equal_row",
    "group_edges",
    "multiplicity_of_rows",
    "outside_segments",
    "pair_edges",
    "robust_count",
    "segments_before_caster",
    "surface_points",
    "triangles_touch",
    "visit_hextree",
    "volume_count",
    "weld",
]

"""Plain twins of the fast kernels: short, exact, slow, and obviously right.

Tests compare every kernel with its twin; ``svprep validate --deep`` compares a
whole cache with those that are vectorised. Nothing here is compiled, and
nothing here imports what it judges.

    tables.py    equal rows, welding, edges grouped and written, components, planes
    pairing.py   edges of several faces paired by exact angle
    contact.py   whether two triangles meet, in rational arithmetic
    sums.py      facing, and the multiplicity of every edge from triangles and from records
    volumes.py   how many faces shade a point, from triangles and from volumes
"""

from svprep.reference.contact import triangles_touch
from svprep.reference.pairing import pair_edges
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
    "Counts",
    "EdgeSums",
    "check_planes",
    "closed_count",
    "components",
    "edge_multiplicity",
    "edge_rows",
    "facing",
    "first_equal_row",
    "group_edges",
    "multiplicity_of_rows",
    "pair_edges",
    "robust_count",
    "triangles_touch",
    "volume_count",
    "weld",
]

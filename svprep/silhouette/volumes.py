"""Which shadow volume a component takes for a light: closed where that is right.

The closed volume counts only faces turned to the light, and needs half the
sides and caps. It is right for a solid while the light is outside its bounds: a
light inside a box finds no face turned its way. Everything else takes the
robust volume, which is right for any triangles (Stich, Waechter, Keller 2007).
"""

from __future__ import annotations

import numpy as np

from svprep.model import BOOL, F32, ComponentFlag, Components, Mesh


def component_bounds(mesh: Mesh, components: Components) -> tuple[F32, F32]:
    """Return each component's lowest and highest corner, ``(n_components, 3)`` [m]."""
    start = components.face_start[:-1]
    low, high = (np.empty((len(start), 3), np.float32) for _ in range(2))
    for axis in range(3):
        # take: several times the speed of positions[...] on rows this short.
        along = mesh.positions[:, axis].take(mesh.faces.reshape(-1))
        low[:, axis] = np.minimum.reduceat(along, 3 * start)
        high[:, axis] = np.maximum.reduceat(along, 3 * start)
    return low, high


def closed_volume_allowed(components: Components, bounds: tuple[F32, F32], light: F32) -> BOOL:
    """Return ``(n_components,)``: solid, and the light outside its bounds.

    ``bounds`` as `component_bounds` returns them; not looked at for a directional
    light, which is always outside. Queries do the same for solids alone:
    `SearchTables.solids_around`.
    """
    is_solid = (components.flags & np.uint8(ComponentFlag.SOLID)) != 0
    if light[3] == 0.0:
        return is_solid
    low, high = bounds
    return is_solid & ((light[:3] < low) | (light[:3] > high)).any(axis=1)

"""Small scenes for sun hours, the sun from pvlib, and rays by brute force in float64."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svprep.facing import facing
from svprep.hours.surfaces import Surfaces, surfaces_of
from svprep.light import Arc, parse_arc
from svprep.model import Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.rays import Scene, offset_m
from tests.property.meshes import side_by_side, source_mesh

BOX_FACES = np.array(
    [
        [0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7],  # bottom, top
        [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5],  # south, east
        [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],  # north, west
    ]
)  # fmt: skip
"""Of the corners (low, low), (high, low), (high, high), (low, high), below and above."""
BOTTOM, TOP, SOUTH, EAST, NORTH, WEST = (range(2 * i, 2 * i + 2) for i in range(6))

VIENNA = (48.2, 16.37, "Europe/Vienna")
SYDNEY = (-33.87, 151.21, "Australia/Sydney")
SVALBARD = (78.22, 15.65, "Arctic/Longyearbyen")


def box(low: tuple[float, ...], high: tuple[float, ...], without: tuple[int, ...] = ()):
    """Return a closed box, or an open one `without` some of its 12 triangles."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    corners = np.array([(*xy, z) for z in (z0, z1) for xy in ring])
    return source_mesh(corners, np.delete(BOX_FACES, list(without), axis=0))


def sheet(corners: list[tuple[float, float, float]]) -> SourceMesh:
    """Return a sheet of two triangles through four corners."""
    return source_mesh(np.array(corners, float), np.array([[0, 1, 2], [0, 2, 3]]))


def level(x0: float, y0: float, x1: float, y1: float, z: float = 0.0) -> SourceMesh:
    """Return a level sheet that is wound to look up."""
    return sheet([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])


def city(*objects: SourceMesh, names: tuple[str, ...] = ()) -> Prepared:
    """Return a prepared city of these objects."""
    source = side_by_side(*objects)
    return prepare(replace(source, object_names=names or source.object_names), BuildConfig())


def surfaces_in(prepared: Prepared) -> Surfaces:
    scene = Scene(prepared.mesh.positions, prepared.mesh.faces)
    return surfaces_of(prepared, scene, offset_m(prepared.mesh))


def arc_at(place: tuple[float, float, str], when: str) -> Arc:
    """Return the arc of `when` (``"2026-06-21/05:00/21:00/15m"``) at a place."""
    return parse_arc(f"sun:{place[0]},{place[1]},{when}[{place[2]}]")


def in_cache_frame(prepared: Prepared, points: object) -> np.ndarray:
    return np.array(points, float).reshape(-1, 3) - prepared.mesh.grid.origin_m


def face_under(prepared: Prepared, point: tuple[float, float, float], name: str) -> int:
    """Return the face of an object whose plane and triangle hold `point` (source)."""
    at = in_cache_frame(prepared, point)[0]
    owner = prepared.object_names.index(name)
    begin, end = prepared.mesh.object_face_start[owner : owner + 2]
    best, found = np.inf, -1
    for face in range(begin, end):
        a, b, c = prepared.mesh.positions[prepared.mesh.faces[face]].astype(float)
        normal = np.cross(b - a, c - a)
        unit = normal / np.linalg.norm(normal)
        height = abs(unit @ (at - a))
        sides = [unit @ np.cross(q - p, at - p) for p, q in ((a, b), (b, c), (c, a))]
        if min(sides) >= -1e-3 and height < best:
            best, found = height, face
    assert best < 1e-2, f"{point} is {best} m away from {name}"
    return found


@dataclass(frozen=True)
class Path:
    """The sun at the steps of an arc, by pvlib alone."""

    towards: np.ndarray
    """``(n_steps, 3)``: unit vectors: east, north, up."""
    is_up: np.ndarray


def sun_path(arc: Arc, step_minutes: float | None = None) -> Path:
    """Return the sun from the begin to the end of an arc, by pvlib alone."""
    import pandas
    from pvlib.solarposition import get_solarposition

    step = pandas.Timedelta(minutes=step_minutes or arc.step_minutes)
    times = pandas.date_range(
        pandas.Timestamp(arc.begin).tz_convert("UTC"),
        pandas.Timestamp(arc.end).tz_convert("UTC"),
        freq=step,
        inclusive="left",
    )
    sun = get_solarposition(times, arc.latitude_deg, arc.longitude_deg)
    altitude = np.radians(sun["apparent_elevation"].to_numpy())
    azimuth = np.radians(sun["azimuth"].to_numpy())
    level_part = np.cos(altitude)
    towards = np.column_stack(
        [level_part * np.sin(azimuth), level_part * np.cos(azimuth), np.sin(altitude)]
    )
    return Path(towards, altitude > 0.0)


def longest_run(lit: np.ndarray) -> int:
    best = run = 0
    for is_lit in lit.tolist():
        run = run + 1 if is_lit else 0
        best = max(best, run)
    return best


def lit_by_brute_force(
    prepared: Prepared,
    surfaces: Surfaces,
    light: np.ndarray,
    position: np.ndarray,
    face: np.ndarray,
    offset: float,
) -> np.ndarray:
    """Return whether each point is lit: the definition, plainly, in float64.

    Moeller and Trumbore 1997, each ray against each face.
    """
    mesh = prepared.mesh
    a, b, c = np.moveaxis(mesh.positions[mesh.faces].astype(float), 1, 0)
    towards = light[:3].astype(float)
    is_front = facing(prepared.planes.planes, light)[prepared.planes.plane_of_face] == surfaces.side
    across = np.cross(towards, c - a)
    scale = ((b - a) * across).sum(axis=1)
    crossed = np.flatnonzero(scale)
    a, b, c, across, scale = (x[crossed] for x in (a, b, c, across, scale))
    lit = np.zeros(len(face), bool)
    for i, f in enumerate(face.tolist()):
        if not is_front[f]:
            continue
        start = position[i] + offset * surfaces.normal[f]
        u = ((start - a) * across).sum(axis=1) / scale
        other = np.cross(start - a, b - a)
        v = other @ towards / scale
        t = (other * (c - a)).sum(axis=1) / scale
        lit[i] = not ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)).any()
    return lit

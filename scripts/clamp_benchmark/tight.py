"""How many stencil updates clamping saves, what it could save at most, and why not more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from clamp_benchmark.kernels import count_updates
from clamp_benchmark.receivers import (
    LitScene,
    Segments,
    between,
    cached,
    cut_faces,
    lit,
    single_faces,
    whole_objects,
)
from clamp_benchmark.views import Views
from svprep.cache.reader import Cache
from svprep.clamp import ClampCosts, clamp_lights
from svprep.light import parse_light
from svprep.model import F64, I64, ClampTable, Prepared
from svprep.parallel import for_each
from svprep.rays import Scene

AZIMUTH_DEG: Final = 135.0
ALTITUDES_DEG: Final = (3.0, 10.0, 30.0, 60.0)
COSTS: Final = (1.0, 4.0, 16.0)
"""Of a vertex, an area of 1; the product's is 4."""
USUAL: Final = 4.0
UNCLAMPED, OWN_BOX, CLAMPED = "unclamped", "own box alone", "clamped"
SINGLE_FACES = "receivers: single faces"
FREE_GAPS = "single faces, free gaps"
CUT_FACES = "receivers: faces cut to the rectangle"
LAST_SURFACE = "ends at the last surface on the middle line"
"""Too short to be drawn, wherever that line is not in the deepest place: an optimistic bound."""
WHOLE_OBJECTS = "receivers: whole objects"
ALL_WHOLE_OBJECTS = "casters and receivers: whole objects"
ALL_UNCLAMPED = "casters: whole objects, unclamped"
_NO_END: Final = 1e30
"""[m]: behind everything."""
_PIXELS_AT_ONCE: Final = 128


class Inconsistent(Exception):
    """Figures that contradict each other: the benchmark or the product is wrong."""


@dataclass(frozen=True, slots=True)
class Updates:
    """What the pixels of all views cost by one table of segments."""

    per_view: list[float]
    """Updates a pixel that is not sky, mean; view after view."""
    total: int
    """Of all views."""
    left_out: int
    """Pairs of `Tight.held` that no segment holds: 0 for what may be drawn."""


@dataclass(frozen=True, slots=True)
class CostRow:
    """What the segments are with one cost of a vertex."""

    segments: float
    """Of a caster, mean."""
    slanted: float
    """Share of casters with a slanted end."""
    gaps: float
    """Share of casters with more than one segment."""
    n_bytes: float
    """Of a caster in the cache."""
    updates: int


@dataclass(frozen=True, slots=True)
class Lengths:
    """Along the light from a caster's front, on the middle line of its rectangle; means, [m]."""

    own_box: float
    to_last_surface: float
    """The last surface that the line meets, or the own box's end if that is farther."""
    clamped_end: float
    clamped: float
    """Without gaps."""
    unclamped: float


@dataclass(frozen=True, slots=True)
class Tight:
    """All figures of a dataset for one altitude of the sun."""

    altitude_deg: float
    n_casters: int
    pixels: list[int]
    """That are not sky, of each view."""
    updates: dict[str, Updates]
    held: int
    """Pairs of a pixel and a caster in whose rectangle, behind whose front, the visible point
    lies: any right clamping of that rectangle updates there at least once."""
    hidden: int
    """Pairs of which this does not hold, but of a point of a surface behind the visible one:
    any clamping that is right for other views, too, updates there at least twice."""
    costs: dict[float, CostRow]
    lengths: Lengths
    area_gain: float
    """Surface of the unclamped volumes over that of the clamped ones."""
    area_gain_own: float

    def gain(self, name: str = CLAMPED) -> float:
        """Return the updates of unclamped volumes over those of clamped ones."""
        whole = ALL_UNCLAMPED if name == ALL_WHOLE_OBJECTS else UNCLAMPED
        return self.updates[whole].total / max(self.updates[name].total, 1)

    def per_pixel(self, name: str) -> float:
        """Return the updates a pixel that is not sky, mean of all views together."""
        return self.updates[name].total / max(sum(self.pixels), 1)

    @property
    def share_of_own_box(self) -> float:
        """Gain over that of own boxes alone."""
        return self.gain() / self.gain(OWN_BOX)

    @property
    def floor(self) -> int:
        """Updates that any clamping of rectangles has at least, if it is right for any view."""
        return self.held + 2 * self.hidden

    @property
    def most_share(self) -> float:
        """What `share_of_own_box` would be if every clamped volume cost its floor."""
        return self.updates[OWN_BOX].total / max(self.floor, 1)

    @property
    def n_costlier_views(self) -> int:
        """Views in which clamped volumes cost more than unclamped ones."""
        whole, clamped = (self.updates[name].per_view for name in (UNCLAMPED, CLAMPED))
        return sum(b > a for a, b in zip(whole, clamped, strict=True))

    @property
    def view_shares(self) -> list[float]:
        """``share_of_own_box`` of each view; where nothing is updated, 1."""
        own, clamped = (self.updates[name].per_view for name in (OWN_BOX, CLAMPED))
        return [a / b if b else 1.0 for a, b in zip(own, clamped, strict=True)]


def measure_tight(cache: Cache | Prepared, views: Views, altitude_deg: float) -> Tight:
    """Return what clamping gains for a sun at one altitude.

    Raises
    ------
    Inconsistent
        A clamped segment leaves out a point that it must hold, or unclamped volumes cost less
        than own boxes.
    """
    mesh, components, tree = cache.mesh, cache.components, cache.scene
    light = parse_light(f"dir:{AZIMUTH_DEG:g},{altitude_deg:g}")
    tables = {
        cost: clamp_lights(mesh, components, tree, [light], ClampCosts(vertex=cost))
        for cost in COSTS
    }
    faces = single_faces(tree)
    by_face = clamp_lights(mesh, components, faces, [light])
    free = clamp_lights(mesh, components, faces, [light], ClampCosts(vertex=0.0))
    usual = tables[USUAL]
    placed = lit(mesh, usual.frames[0])
    casters = placed.boxes(components.face_start)
    front, back = casters[:, 4], casters[:, 5]
    last = last_surfaces(placed, casters)
    subjects = {
        UNCLAMPED: between(front, np.full(len(front), _NO_END)),
        OWN_BOX: between(front, back),
        CLAMPED: cached(usual),
        SINGLE_FACES: cached(by_face),
        FREE_GAPS: cached(free),
        WHOLE_OBJECTS: whole_objects(placed, tree, components.face_start, ClampCosts()),
        CUT_FACES: cut_faces(placed, tree, components.face_start),
        LAST_SURFACE: between(front, last),
    }
    costs = {cost: cached(table) for cost, table in tables.items() if cost != USUAL}
    updates, floor = updates_of(
        placed, casters, views, subjects | {str(cost): table for cost, table in costs.items()}
    )
    objects_start = np.unique(mesh.object_face_start)
    boxes = placed.boxes(objects_start)
    whole = {
        ALL_UNCLAMPED: between(boxes[:, 4], np.full(len(boxes), _NO_END)),
        ALL_WHOLE_OBJECTS: whole_objects(placed, tree, objects_start, ClampCosts()),
    }
    updates |= updates_of(placed, boxes, views, whole)[0]
    _check(updates, altitude_deg)
    _, _, unclamped_m2, own_m2, clamped_m2 = usual.facts[0].tolist()
    return Tight(
        altitude_deg=altitude_deg,
        n_casters=len(casters),
        pixels=views.is_surface.sum(axis=1).tolist(),
        updates={name: updates[name] for name in (*subjects, *whole)},
        held=floor[0],
        hidden=floor[1],
        costs={
            cost: _cost_row(table, updates[CLAMPED if cost == USUAL else str(cost)].total)
            for cost, table in tables.items()
        },
        lengths=_lengths(placed, casters, last, subjects[CLAMPED]),
        area_gain=unclamped_m2 / clamped_m2,
        area_gain_own=unclamped_m2 / own_m2,
    )


def updates_of(
    placed: LitScene, boxes: F64, views: Views, tables: Mapping[str, Segments]
) -> tuple[dict[str, Updates], tuple[int, int]]:
    """Return what each table of segments costs, and the pairs ``held`` and ``hidden``.

    Parameters
    ----------
    boxes : ndarray
        ``(n_casters, 6) float64`` [m]: of the casters, in the light's frame.

    Notes
    -----
    O(pixels x casters), on all threads.
    """
    names, listed = list(tables), list(tables.values())
    sizes = [len(table.depths) for table in listed]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    start = np.stack([t.start + offset for t, offset in zip(listed, offsets[:-1], strict=True)])
    depths = np.concatenate([table.depths for table in listed])
    slopes = np.concatenate([table.slopes for table in listed])
    origins = np.ascontiguousarray(views.origins @ placed.frame.T)
    directions = np.ascontiguousarray(views.directions @ placed.frame.T)
    n = len(origins)
    counts = np.zeros((n, len(names)), np.int64)
    left_out = np.zeros((n, len(names)), np.int64)
    floor = np.zeros((n, 2), np.int64)

    def do(batch: int) -> None:
        begin = batch * _PIXELS_AT_ONCE
        count_updates(
            origins, directions, views.seen, views.hidden_start, views.hidden, boxes, start, depths,
            slopes, begin, min(n, begin + _PIXELS_AT_ONCE), counts, floor, left_out,
        )  # fmt: skip

    for_each(-(-n // _PIXELS_AT_ONCE), do)
    held, hidden = floor.sum(axis=0).tolist()
    return {
        name: Updates(_per_view(counts[:, k], views), int(counts[:, k].sum()), int(left))
        for k, (name, left) in enumerate(zip(names, left_out.sum(axis=0), strict=True))
    }, (held, hidden)


def _per_view(counts: I64, views: Views) -> list[float]:
    """Return the mean of each view's pixels that are not sky; of sky alone, 0."""
    n_surface = np.maximum(views.is_surface.sum(axis=1), 1)
    return (counts.reshape(len(views.eyes), -1).sum(axis=1) / n_surface).tolist()


def _cost_row(table: ClampTable, updates: int) -> CostRow:
    """Return what one light's segments are."""
    segments = cached(table)
    counts = segments.per_caster
    caster = np.repeat(np.arange(len(counts)), counts)
    is_slanted = np.zeros(len(counts), bool)
    is_slanted[caster[(segments.slopes != 0.0).any(axis=1)]] = True
    n_bytes = table.segment_start[0].nbytes + table.depths.nbytes + table.slopes.nbytes
    return CostRow(
        segments=float(counts.mean()),
        slanted=float(is_slanted.mean()),
        gaps=float((counts > 1).mean()),
        n_bytes=n_bytes / len(counts),
        updates=updates,
    )


def last_surfaces(placed: LitScene, boxes: F64) -> F64:
    """Return how deep the last surface on the middle line of each rectangle is, ``(n,)`` [m].

    At least the depth of the box's own end.
    """
    u, v = boxes[:, :2].mean(axis=1), boxes[:, 2:4].mean(axis=1)
    # From behind the scene against the light: the first surface is the last one.
    behind = float(placed.placed[:, 2].max()) + 1.0
    starts = np.column_stack([u, v, np.full(len(u), behind)]) @ placed.frame
    against = np.tile(-placed.frame[2], (len(u), 1)).astype(np.float32)
    scene = Scene(placed.mesh.positions, placed.mesh.faces)
    face, distance = scene.first_hit(np.ascontiguousarray(starts, dtype=np.float32), against)
    return np.where(face >= 0, np.maximum(behind - distance, boxes[:, 5]), boxes[:, 5])


def _lengths(placed: LitScene, boxes: F64, last: F64, segments: Segments) -> Lengths:
    """Return the mean lengths of casters' shadows on the middle lines of their rectangles."""
    middle = np.column_stack([boxes[:, :2].mean(axis=1), boxes[:, 2:4].mean(axis=1)])
    front, back = boxes[:, 4], boxes[:, 5]
    at = (segments.slopes * np.repeat(middle, segments.per_caster, axis=0)).sum(axis=1)
    near, far = segments.depths[:, 0] + at, segments.depths[:, 1] + at
    near[segments.start[:-1]] = front  # whatever is stored
    held = np.add.reduceat(np.maximum(far - near, 0.0), segments.start[:-1])
    return Lengths(
        own_box=float((back - front).mean()),
        to_last_surface=float((last - front).mean()),
        clamped_end=float((far[segments.start[1:] - 1] - front).mean()),
        clamped=float(held.mean()),
        unclamped=float((placed.placed[:, 2].max() - front).mean()),
    )


def _check(updates: Mapping[str, Updates], altitude_deg: float) -> None:
    """Raise unless all is as it must be."""
    for name, found in updates.items():
        if name not in (OWN_BOX, LAST_SURFACE) and found.left_out:
            raise Inconsistent(
                f"altitude {altitude_deg:g}, {name}: {found.left_out} visible points in a caster's "
                "rectangle behind its front lie in none of its segments, expected 0"
            )
    for view, (own, whole) in enumerate(
        zip(updates[OWN_BOX].per_view, updates[UNCLAMPED].per_view, strict=True)
    ):
        if whole < own / 2.0:
            raise Inconsistent(
                f"altitude {altitude_deg:g}, view {view}: {whole} updates a pixel unclamped, "
                f"{own} of own boxes alone"
            )

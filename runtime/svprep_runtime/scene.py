"""A cache in graphics memory, and per light the volumes that were asked for.

    Scene           positions, corners, edges           once
      LitScene      facing, segments                    once a light
        Batch       entries: what a counting draws      once a light, construction and choice
                                                        of components

Visible casters and receivers of a frame (culling) will choose batches here.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from svprep.errors import InputError
from svprep.model import BOOL, F32, F64, U32, Prepared
from svprep_runtime import gl_raw as g
from svprep_runtime import residency as r
from svprep_runtime.context import Context
from svprep_runtime.passes.counting import Draw
from svprep_runtime.programs import Programs
from svprep_runtime.volumes import (
    CastersOf,
    Segments,
    VolumeLists,
    casters_of,
    edge_vertices,
    face_entries,
    face_neighbours,
    segments_of,
    volume_lists,
)

if TYPE_CHECKING:
    import moderngl

    from svprep.cache.reader import Cache

Construction = Literal["vertex", "geometry", "triangles"]
"""Who makes volumes: vertex shaders from silhouette edges; a geometry shader from faces and
their neighbours; the same of each triangle alone, to compare with."""

MOST_LIGHTS: Final = 64
"""Kept of those that were drawn; beyond, the one asked for first goes."""
MOST_BATCHES: Final = 6
"""Kept of a light; the one used longest ago goes."""


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Entries in graphics memory, and the draws over them."""

    entries: moderngl.Buffer
    draws: tuple[Draw, ...]

    @property
    def n_entries(self) -> int:
        """Of all draws."""
        return sum(draw.n_entries for draw in self.draws)


@dataclass(slots=True, eq=False)
class LitScene:
    """What one light adds to a scene, clamped or not."""

    casters: CastersOf
    segments: Segments
    facing: moderngl.Buffer
    segment_table: moderngl.Buffer
    batches: OrderedDict[tuple[object, ...], Batch] = field(default_factory=OrderedDict)

    @property
    def uniforms(self) -> dict[str, Any]:
        """What shaders ask of the light."""
        u, v, t = (tuple(row.tolist()) for row in self.segments.frame)
        return {
            "light": tuple(self.casters.light.tolist()),
            "light_u": u,
            "light_v": v,
            "light_t": t,
        }


class Scene:
    """A cache, ready to be drawn. Release it, or use it in a ``with``.

    Parameters
    ----------
    context : Context
        Current, and so for every later call.
    cache : Cache or Prepared
        Its tables must outlive the scene.
    budget_bytes : int
        Of graphics memory for buffers; pictures are not counted.

    Raises
    ------
    EnvironmentProblem
        The budget, or the driver's largest buffer, is too small.
    CacheError
        The cache is damaged.
    """

    def __init__(
        self,
        context: Context,
        cache: Cache | Prepared,
        budget_bytes: int = r.DEFAULT_BUDGET_BYTES,
    ) -> None:
        self.context, self.cache = context, cache
        self.programs = Programs(context)
        self.memory = r.Memory(context, budget_bytes)
        self._lights: dict[tuple[bytes, bool], LitScene] = {}
        # Read and uploaded when first drawn: what is seen needs neither.
        self._neighbours: moderngl.Buffer | None = None
        self._edges: moderngl.Buffer | None = None
        try:
            mesh = cache.mesh
            self.n_faces = len(mesh.faces)
            largest = np.abs(mesh.positions).max(initial=0.0)
            self.corners = _corners_of_box(mesh.positions)
            self.ulp_m = float(np.spacing(np.float32(largest)))
            self._bound = (
                (r.POSITIONS, self.memory.upload(mesh.positions, "the positions")),
                (r.CORNERS, self.memory.upload(mesh.faces, "the faces")),
            )
            self.tally = self.memory.upload(np.zeros(4, np.uint32), "the tally")
        except BaseException:
            self.release()
            raise

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *error: object) -> None:
        self.release()

    def release(self) -> None:
        """Give all graphics memory back."""
        self.programs.release()
        self.memory.release()
        self._lights.clear()

    def bind(self) -> None:
        """Bind what every pass reads."""
        for binding, buffer in self._bound:
            buffer.bind_to_storage_buffer(binding)
        self.tally.bind_to_storage_buffer(r.TALLY)

    def read_shift_px(self) -> float:
        """Return how far beside the centre of its pixel a point is displaced at most [pixels]."""
        self.context.gl.glMemoryBarrier(g.GL_ALL_BARRIER_BITS)
        return float(np.frombuffer(self.tally.read(4, offset=8), np.float32)[0])

    def read_tally(self) -> tuple[int, int]:
        """Return how many pixels have a negative count, and the highest count."""
        self.context.gl.glMemoryBarrier(g.GL_ALL_BARRIER_BITS)
        negative, highest = np.frombuffer(self.tally.read(8), np.uint32).tolist()
        return negative, highest

    def lit_by(self, light: F32, *, clamped: bool) -> LitScene:
        """Return what a light adds; looked up, or computed and uploaded."""
        key = (light.tobytes(), clamped)
        if key not in self._lights:
            while len(self._lights) >= MOST_LIGHTS:
                oldest = next(iter(self._lights))[0]
                self.forget(np.frombuffer(oldest, np.float32))
            checked_light(light, self.cache.mesh.positions)
            other = self._lights.get((light.tobytes(), not clamped))
            casters = other.casters if other else casters_of(self.cache, light)
            segments = segments_of(self.cache, light, clamped=clamped)
            of_faces = self.memory.upload(casters.facing, "the facing of faces")
            try:
                table = self.memory.upload(segments.table, "the segments")
            except BaseException:
                self.memory.free(of_faces)
                raise
            self._lights[key] = LitScene(casters, segments, of_faces, table)
        return self._lights[key]

    def forget(self, light: F32) -> None:
        """Give back what was kept for a light."""
        for clamped in (False, True):
            lit = self._lights.pop((light.tobytes(), clamped), None)
            if lit is not None:
                for batch in lit.batches.values():
                    self.memory.free(batch.entries)
                self.memory.free(lit.facing)
                self.memory.free(lit.segment_table)

    def bind_light(self, lit: LitScene) -> None:
        """Bind what passes read of a light."""
        lit.facing.bind_to_storage_buffer(r.FACING)
        lit.segment_table.bind_to_storage_buffer(r.SEGMENTS)

    def batch(
        self,
        lit: LitScene,
        construction: Construction,
        chosen: BOOL | None = None,
        *,
        whole: bool = False,
        near_plane: bool = False,
    ) -> Batch:
        """Return the volumes of the components that are `chosen`, all if None.

        `whole`: as if nothing were clamped. `near_plane`: only their faces, for zp+.
        """
        name = None if chosen is None else np.packbits(chosen).tobytes()
        key = (construction, name, whole, near_plane)
        if key in lit.batches:
            lit.batches.move_to_end(key)
            return lit.batches[key]
        if near_plane:
            faces = np.concatenate(face_entries(lit.casters, lit.segments, chosen, whole=True))
            parts = [(faces, Draw("caps", 1, 0, len(faces)))]
        elif construction == "vertex":
            lists = volume_lists(lit.casters, lit.segments, chosen, whole=whole)
            parts = _vertex_draws(lists)
        else:
            towards, away = face_entries(lit.casters, lit.segments, chosen, whole=whole)
            is_alone = construction == "triangles"
            parts = _numbered(
                [
                    (towards, Draw("faces", 1, 0, 0, each_alone=is_alone)),
                    (away, Draw("faces", -1, 0, 0, each_alone=is_alone)),
                ]
            )
        while len(lit.batches) >= MOST_BATCHES:
            self.memory.free(lit.batches.popitem(last=False)[1].entries)
        entries = np.concatenate([part for part, _ in parts])
        lit.batches[key] = Batch(
            self.memory.upload(entries, "the volumes of a light"), tuple(d for _, d in parts)
        )
        return lit.batches[key]

    def bind_batch(self, batch: Batch) -> None:
        """Bind what draws of a batch read."""
        batch.entries.bind_to_storage_buffer(r.ENTRIES)
        kinds = {draw.kind for draw in batch.draws}
        if "faces" in kinds:
            if self._neighbours is None:
                table = face_neighbours(self.cache.mesh, self.cache.edges)
                self._neighbours = self.memory.upload(table, "the neighbours of faces")
            self._neighbours.bind_to_storage_buffer(r.NEIGHBOURS)
        if kinds & {"sides", "sides_to_point"}:
            if self._edges is None:
                self._edges = self.memory.upload(edge_vertices(self.cache.edges), "the edges")
            self._edges.bind_to_storage_buffer(r.EDGE_VERTICES)


def _corners_of_box(positions: F32) -> F64:
    """Return ``(8, 3)`` [m]: the corners of the box around positions; the origin for none."""
    if not len(positions):
        return np.zeros((8, 3))
    sides = np.stack([positions.min(axis=0), positions.max(axis=0)], axis=1).astype(np.float64)
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def checked_light(light: F32, positions: F32) -> None:
    """Raise `InputError` if a point light lies on a vertex: its shadow has no side there."""
    if light[3] != 0.0 and (positions == light[:3]).all(axis=1).any():
        raise InputError(
            "the point light lies exactly on a vertex of the model, where it lights no side; "
            "move it by a millimetre"
        )


def _vertex_draws(lists: VolumeLists) -> list[tuple[U32, Draw]]:
    parts = [
        (lists.sides_to_point, Draw("sides_to_point", 1, 0, 0)),
        (lists.sides, Draw("sides", 1, 0, 0)),
    ]
    for sign, i in ((1, 0), (-1, 1)):
        parts += [
            (lists.light_caps[i], Draw("caps", sign, 0, 0, is_own_cap=True)),
            (lists.near_caps[i], Draw("caps", sign, 0, 0)),
            (lists.far_caps[i], Draw("caps", -sign, 0, 0, is_far=True)),
            (lists.endless_caps[i], Draw("caps", -sign, 0, 0, is_far=True, is_own_cap=True)),
        ]
    return _numbered(parts)


def _numbered(parts: list[tuple[U32, Draw]]) -> list[tuple[U32, Draw]]:
    """Return `parts` with each draw's entries where they lie once all are joined."""
    first = 0
    numbered = []
    for entries, draw in parts:
        numbered.append((entries, replace(draw, first_entry=first, n_entries=len(entries))))
        first += len(entries)
    return numbered

"""Prove that a cache is right: `quick` reads it, `deep` recomputes what it claims.

Deep checks, each against something that does not share its code:

    multiplicities   the plain float64 twin, straight from the cached triangles
    closed volumes   the signed boundary of sides and caps is zero at each vertex
    silhouettes      what the searches find is where those multiplicities are not zero
    cones            every sphere and cone of the trees holds the edges below it
    segments         rays find the casters between points and each light: every point lies in
                     a segment of each of its casters
    solids           manifold3d takes each for a manifold with positive volume
    repair           repairing the cached mesh again changes nothing
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from svprep.cache.checks import CHECKS, Check, Problem
from svprep.cache.reader import Cache, open_cache
from svprep.cache.tables import Tables
from svprep.cache.tree_bounds import CONE_NEEDS, cone_problems
from svprep.cache.verify import verify
from svprep.defects import DEFECTS
from svprep.edges import build_edges
from svprep.errors import InputError, first_few, require_extra
from svprep.facing import facing
from svprep.model import (
    F32,
    F64,
    I64,
    NO_INDEX,
    ComponentFlag,
    Components,
    EdgeTable,
    Mesh,
)
from svprep.planes import build_planes
from svprep.reference import EdgeSums
from svprep.reference.casters import (
    CasterRays,
    outside_segments,
    segments_before_caster,
    surface_points,
)
from svprep.repair.stage import repair
from svprep.silhouette import Method, silhouette
from svprep.silhouette.volumes import closed_volume_allowed, component_bounds

N_LIGHTS = 100
"""Lights of a deep check: half directional, half points, some inside solids."""

N_POINTS = 2000
"""Random points of the surface, for each light that the cache clamps shadows for."""

SEARCHES: tuple[Method, ...] = ("auto", "cones", "hextree")
"""The methods of `silhouette` that a deep check compares with the records."""

_BUG = (
    "Shadows may be wrong. Build the cache again with a released svprep; report it if that fails."
)

DEEP_CHECKS: dict[str, Check] = {
    c.code: c
    for c in (
        Check(
            "V601",
            "WRONG_MULTIPLICITY",
            "How often an edge's side is needed differs from what the triangles say.",
            _BUG,
        ),
        Check(
            "V602",
            "OPEN_VOLUME",
            "For some light the sides and caps of a shadow volume leave a gap.",
            _BUG,
        ),
        Check(
            "V603",
            "DOUBTFUL_SOLID",
            "manifold3d does not take a component for a solid that svprep calls one.",
            _BUG,
        ),
        Check(
            "V604",
            "UNSTABLE_REPAIR",
            "Repairing the cached mesh again gives another result.",
            "The cache was built by another version, or the repair has a fault. " + _BUG,
        ),
        Check(
            "V605",
            "WRONG_SILHOUETTE",
            "A search for silhouettes finds other edges than those whose multiplicity is not 0, or "
            "another multiplicity.",
            _BUG,
        ),
        Check(
            "V606",
            "CUT_SHADOW",
            "A point in the shadow of a component, as a ray finds, lies in none of its clamped "
            "segments for that light.",
            "Drawn clamped, that shadow has a hole; with --clamp none it is right. " + _BUG,
        ),
        Check(
            "V607",
            "EARLY_SEGMENT",
            "A later segment of a component begins before a part of the component itself, on the "
            "side of the light.",
            "Drawn clamped, what lies there in the light is in shadow; with --clamp none it is "
            "right. " + _BUG,
        ),
    )
}
"""The checks of `validate --deep`; those of the quick check are `cache.checks.CHECKS`."""

Step = Callable[[str, int, int], None]
"""Told what is being checked, and how far it is: ``(what, done, of)``."""


@dataclass(frozen=True, slots=True)
class Validation:
    """The outcome of a validation."""

    path: str
    is_deep: bool
    problems: tuple[Problem, ...]
    checks: tuple[str, ...]
    """One line per check that passed, with what it covered."""

    @property
    def is_valid(self) -> bool:
        """Whether no check found a problem."""
        return not self.problems


def validate(path: str | Path, *, deep: bool = False, on_step: Step | None = None) -> Validation:
    """Check a cache: structure and digests, and with `deep` its mathematics.

    Raises
    ------
    CacheError
        The file is missing or is no cache at all.
    EnvironmentProblem
        `deep` without the package manifold3d, or embreex where the cache has lights.
    """
    step = on_step or (lambda what, done, of: None)
    if deep:
        _manifold_type()  # before any long work
    step("structure and digests", 0, 1)
    problems = list(verify(Path(path)))
    checks = ["structure, digests, ranges and table invariants"] if not problems else []
    if deep and not problems:
        with open_cache(path) as cache:
            for check in (
                _check_volumes,
                _check_searches,
                _check_segments,
                _check_solids,
                _check_repair_again,
            ):
                line, found = check(cache, step)
                checks += [line] if line and not found else []
                problems += found
    return Validation(path=str(path), is_deep=deep, problems=tuple(problems), checks=tuple(checks))


def explain(code: str) -> str:
    """Return the documentation of a defect (D302) or check (V203) code, or of its name.

    Raises
    ------
    InputError
        There is no such code: lists those there are.
    """
    wanted = code.strip().upper().split(" ")[0]
    for defect in DEFECTS.values():
        if wanted in (f"D{int(defect.code)}", str(int(defect.code)), defect.code.name):
            return (
                f"{defect.label} (counted per {defect.unit})\n"
                f"What:   {defect.summary}\nAction: {defect.action}"
            )
    checks = {**CHECKS, **DEEP_CHECKS}
    for check in checks.values():
        if wanted in (check.code, check.name):
            return f"{check.label}\nWhat:  {check.summary}\nMeans: {check.consequence}"
    known = ", ".join([*(f"D{int(c)}" for c in DEFECTS), *checks])
    raise InputError(f'there is no code "{code}"; there are: {known}')


def random_lights(
    mesh: Mesh, components: Components, n_lights: int = N_LIGHTS, seed: int = 0
) -> F32:
    """Return ``(n_lights, 4) float32`` lights in the cache frame, seeded.

    In turn: a direction from above, a direction from anywhere, a point within
    the bounds of a random solid component (or of the model), a point around the
    model up to ten times its extent away, below the ground too.
    """
    rng = np.random.default_rng(seed)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    centre, extent = (low + high) / 2.0, float((high - low).max())
    solids = np.flatnonzero(components.flags & np.uint8(ComponentFlag.SOLID))
    lights = np.zeros((n_lights, 4), np.float32)
    for i in range(n_lights):
        kind = i % 4
        if kind < 2:
            direction = rng.normal(size=3)
            if kind == 0:
                direction[2] = abs(direction[2])
            lights[i, :3] = direction / np.linalg.norm(direction)
            continue
        if kind == 2 and len(solids):
            chosen = int(rng.choice(solids))
            faces = mesh.faces[components.face_start[chosen] : components.face_start[chosen + 1]]
            corners = mesh.positions[faces.reshape(-1)]
            inside = corners.min(axis=0), corners.max(axis=0)
            lights[i, :3] = rng.uniform(*inside)
        elif kind == 2:
            lights[i, :3] = rng.uniform(low, high)
        else:
            lights[i, :3] = centre + rng.normal(size=3) * extent * 10.0 ** rng.uniform(-1, 1)
        lights[i, 3] = 1.0
    return lights


def row_multiplicity(edges: EdgeTable, facing_of_face: I64) -> I64:
    """Return ``(n_edges,)``: ``m = s_left - s_right`` of each record."""
    padded = np.append(facing_of_face, 0)  # NO_INDEX faces nothing
    faces = np.where(edges.rows[:, 2:] == NO_INDEX, len(facing_of_face), edges.rows[:, 2:])
    sides = padded[faces]
    return sides[:, 0] - sides[:, 1]


def _facings(cache: Cache, what: str, step: Step) -> Iterator[tuple[F32, I64, I64]]:
    """Yield each light of a deep check with the facing of faces, ``(n_faces,)``, twice.

    First that of the robust volume; then that of the closed volume, where a face turned
    away counts 0, for components that may take it.
    """
    mesh, components, planes = cache.mesh, cache.components, cache.planes
    bounds = component_bounds(mesh, components)
    component_of_face = np.repeat(np.arange(len(components.flags)), np.diff(components.face_start))
    for i, light in enumerate(random_lights(mesh, components)):
        step(what, i, N_LIGHTS)
        side = facing(planes.planes, light).astype(np.int64)[planes.plane_of_face]
        allowed = closed_volume_allowed(components, bounds, light)[component_of_face]
        yield light, side, np.where(allowed, side > 0, side)


def _check_volumes(cache: Cache, step: Step) -> tuple[str, list[Problem]]:
    """Multiplicities against the plain twin, and both volumes closed, for each light."""
    mesh, edges, components = cache.mesh, cache.edges, cache.components
    sums = EdgeSums(mesh.faces)
    edge_of_rows = sums.edge_of_rows(edges.rows)
    balance = _VertexBalance(edges, components, len(mesh.positions))
    problems: list[Problem] = []
    for light, side, closed_side in _facings(cache, "shadow volumes", step):
        by_rows = sums.of_rows(edges.rows, side, edge_of_rows)
        by_triangles = sums.of_triangles(side)
        wrong = np.flatnonzero(by_rows != by_triangles)
        if len(wrong):
            problems.append(
                Problem(
                    "V601",
                    "edges/half_edges",
                    f"light {light.tolist()}: multiplicity differs from the triangles' own at "
                    f"edges {first_few(wrong)}",
                )
            )
        for name, chosen in (("robust", side), ("closed", closed_side)):
            open_at = balance.unbalanced(row_multiplicity(edges, chosen))
            if len(open_at):
                problems.append(
                    Problem(
                        "V602",
                        "edges/half_edges",
                        f"light {light.tolist()}: the {name} volume is open at vertices "
                        f"{first_few(open_at)}",
                    )
                )
    line = (
        f"{N_LIGHTS} lights: multiplicities equal the triangles' own on "
        f"{sums.n_edges:,} edges; robust and closed volumes are closed"
    )
    return line, problems


def _check_searches(cache: Cache, step: Step) -> tuple[str, list[Problem]]:
    """The bounds of the trees of cones; what searches find against all multiplicities."""
    arrays = {path: cache.raw(path) for path in CONE_NEEDS}
    problems = cone_problems(Tables(arrays, {}, cache.grid.step_m, cache.planes.tolerance_m))
    for light, _, closed_side in _facings(cache, "silhouettes", step):
        m = row_multiplicity(cache.edges, closed_side)
        for method in SEARCHES:
            found = silhouette(cache, light, method)
            # Sums: a record that is found twice counts twice.
            by_search = np.bincount(found.edge, found.multiplicity, len(m))
            if len(differing := np.flatnonzero(by_search != m)):
                problems.append(
                    Problem(
                        "V605",
                        "cones" if method == "cones" else "hextree",
                        f"light {light.tolist()}: method {method} differs from the multiplicities "
                        f"at edge records {first_few(differing)}",
                    )
                )
    line = (
        f"{N_LIGHTS} lights: {', '.join(SEARCHES)} find the silhouette, no edge more or less; "
        f"bounds hold in {len(cache.index.objects):,} trees"
    )
    return line, problems


def _check_segments(cache: Cache, step: Step) -> tuple[str, list[Problem]]:
    """Rays against the clamped segments of every light of the cache, if it has any."""
    table = cache.clamp
    if not len(table):
        return "", []
    rays = CasterRays(cache.mesh, cache.components)
    rng = np.random.default_rng(0)
    problems: list[Problem] = []
    n_pairs, n_cut_off = 0, 0
    for i, spec in enumerate(table.specs):
        step("clamped segments", i, len(table))
        early = segments_before_caster(table, i, cache.mesh, cache.components)
        if len(early):
            problems.append(
                Problem(
                    "V607",
                    "clamp/depth",
                    f'light "{spec}": later segments begin before their caster: {first_few(early)}',
                )
            )
        points = surface_points(cache.mesh, N_POINTS, rng)
        pairs = rays.between(points, table.lights[i])
        n_pairs += len(pairs.point)
        n_cut_off += pairs.n_cut_off
        wrong = np.flatnonzero(outside_segments(table, i, points, pairs))
        if len(wrong):
            first = wrong[0]
            at = (points[pairs.point[first]] + cache.grid.origin_m).round(3).tolist()
            problems.append(
                Problem(
                    "V606",
                    "clamp/depth",
                    f'light "{spec}": {len(wrong)} of {len(pairs.point)} pairs of a point and a '
                    f"component that shadows it lie outside its segments; the first is {at} behind "
                    f"component {int(pairs.component[first])}",
                )
            )
    told = f" ({n_cut_off:,} rays met too many to follow)" if n_cut_off else ""
    line = (
        f"{len(table)} lights: {n_pairs:,} pairs of a point and a component between it and the "
        f"light, found by rays, all lie in a segment, and none begins before its caster{told}"
    )
    return line, problems


class _VertexBalance:
    """Whether silhouette edges, each |m| times, run in closed loops per component.

    With the light cap's boundary being exactly those edges, sides and caps then
    have no boundary: the volume is closed.
    """

    def __init__(self, edges: EdgeTable, components: Components, n_vertices: int) -> None:
        component = np.repeat(
            np.arange(len(components.flags), dtype=np.int64), np.diff(components.edge_start)
        )
        key = component[:, None] * n_vertices + edges.rows[:, :2].astype(np.int64)
        self._keys, numbers = np.unique(key, return_inverse=True)
        self._ends = numbers.reshape(-1, 2)
        self._n_vertices = n_vertices

    def unbalanced(self, multiplicity: I64) -> I64:
        """Return vertices where more edges end than begin, or fewer."""
        active = np.flatnonzero(multiplicity)
        m = multiplicity[active].astype(np.float64)
        n = len(self._keys)
        ending: F64 = np.bincount(self._ends[active, 1], m, n).astype(np.float64)
        beginning = np.bincount(self._ends[active, 0], m, n)
        return self._keys[np.flatnonzero(ending != beginning)] % self._n_vertices


def _manifold_type() -> tuple[type, type]:
    try:
        from manifold3d import Manifold
        from manifold3d import Mesh as ManifoldMesh
    except ImportError:
        raise require_extra("manifold3d", "judge", "validate --deep") from None
    return Manifold, ManifoldMesh


def _check_solids(cache: Cache, step: Step) -> tuple[str, list[Problem]]:
    """Ask manifold3d whether each solid component is one."""
    manifold, manifold_mesh = _manifold_type()
    mesh, components = cache.mesh, cache.components
    solids = np.flatnonzero(components.flags & np.uint8(ComponentFlag.SOLID))
    refused = []
    for done, i in enumerate(solids):
        if done % 256 == 0:
            step("solids", done, len(solids))
        faces = mesh.faces[components.face_start[i] : components.face_start[i + 1]]
        used, local = np.unique(faces, return_inverse=True)
        # About its own corner, so that float32 inside manifold3d costs nothing.
        points = mesh.positions[used] - mesh.positions[used[0]]
        body = manifold(
            manifold_mesh(
                vert_properties=np.ascontiguousarray(points, np.float32),
                tri_verts=local.reshape(-1, 3).astype(np.uint32),
            )
        )
        if body.status().name != "NoError" or body.volume() <= 0.0:
            refused.append((int(i), body.status().name))
    line = f"manifold3d agrees on {len(solids) - len(refused):,} of {len(solids):,} solids"
    if not refused:
        return line, []
    shown = [f"{i} ({status})" for i, status in refused]
    return line, [
        Problem(
            "V603", "components/flags", f"manifold3d refuses solid components {first_few(shown)}"
        )
    ]


_MESH_ARRAYS = ("positions", "faces", "object_vertex_start", "object_face_start", "source_face")


def _check_repair_again(cache: Cache, step: Step) -> tuple[str, list[Problem]]:
    """Repair the cached mesh once more: nothing may change."""
    step("repair again", 0, 1)
    # Copies, because Numba would compile every kernel again for read-only arrays.
    mesh = replace(cache.mesh, **{k: getattr(cache.mesh, k).copy() for k in _MESH_ARRAYS})
    again, report = repair(mesh)
    planes = build_planes(again, cache.planes.tolerance_m)
    edges, components = build_edges(again, planes)
    changed = {
        "mesh/face_corners": not np.array_equal(again.mesh.faces, cache.mesh.faces),
        "edges/half_edges": not np.array_equal(edges.rows, cache.edges.rows),
        "edges/flags": not np.array_equal(edges.flags, cache.edges.flags),
        "planes/plane_of_face": not np.array_equal(
            planes.plane_of_face, cache.planes.plane_of_face
        ),
        "components/flags": not _same_but_inverted(components, cache.components),
    }
    problems = [
        Problem("V604", name, "repairing the cached mesh again gives another table")
        for name, differs in changed.items()
        if differs
    ]
    if len(report.flipped_faces) or len(report.duplicates.code):
        problems.append(
            Problem(
                "V604",
                "mesh/face_corners",
                f"repairing again flips {len(report.flipped_faces)} faces and drops "
                f"{len(report.duplicates.code)}",
            )
        )
    return "repairing again changes nothing", problems


def _same_but_inverted(a: Components, b: Components) -> bool:
    """Compare component tables; INVERTED tells of the source and is gone by then."""
    told = np.uint8(0xFF ^ ComponentFlag.INVERTED)
    return (
        np.array_equal(a.flags & told, b.flags & told)
        and np.array_equal(a.face_start, b.face_start)
        and np.array_equal(a.edge_start, b.edge_start)
        and np.array_equal(a.object_start, b.object_start)
    )


def problem_lines(validation: Validation) -> Iterator[str]:
    """Yield a line per problem, as the command line prints them."""
    checks = {**CHECKS, **DEEP_CHECKS}
    for problem in validation.problems:
        yield (
            f"{checks[problem.code].label}: {validation.path}, {problem.where}: "
            f"{problem.message}. See: svprep validate --explain {problem.code}"
        )

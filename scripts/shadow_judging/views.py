"""Six views and four lights of any model, found by rays.

    street       at a person's height, along the street that shows most
    inside       in a courtyard; by lamplight in the room that the lamp is in
    in shadow    where the light does not reach, looking at both light and shadow
    near plane   so close to a wall that the near plane cuts it
    oblique      8 degrees down
    bird         50 degrees down

Of the candidates for a view the one with the highest score is taken: how much surface it
shows, how much of that at a sensible distance, how many edges, and how much of both light
and shadow. No view is chosen, or left out, by how it
is drawn. The lights are three suns, whose altitudes are above the model's own ground, and a
lamp in the closed space nearest to the model's middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from shadow_judging.place import EYE_M, Place, all_around, compass
from svprep.light import Light, parse_light
from svprep.model import F32, F64, I32, Grid, Mesh
from svprep_runtime.camera import DEFAULT_FOV_DEG, DEFAULT_NEAR_M, Camera, parse_camera

VIEWS: Final = ("street", "inside", "in shadow", "near plane", "oblique", "bird")
SUNS: Final = {"sun 3": (115.0, 3.0), "sun 20": (225.0, 20.0), "sun 60": (160.0, 60.0)}
"""Azimuth and altitude in degrees, on the model's own ground."""
LAMP: Final = "lamp"
LIGHTS: Final = (*SUNS, LAMP)

_ASPECT: Final = 1280 / 1024
_COARSE: Final = (20, 16)
"""Rays of a candidate's picture: columns, rows."""
_AT_ONCE: Final = 128
"""Candidates whose rays are traced together."""
_NEAR_CUT_M: Final = 0.25
"""The near plane of the view in which it cuts a wall, for an eye at 1.7 m."""
_ENOUGH_SURFACE: Final = 0.8
_ENOUGH_EDGES: Final = 0.4
"""More of these do not raise a score: a blank wall is no view, nor is a heap of leaves."""
_FEWEST_WALLS: Final = 22
"""Of 24 rays around, which end nearby in a courtyard."""


@dataclass(frozen=True, slots=True)
class View:
    """A camera as a user would write it, and its near plane."""

    name: str
    spec: str
    near_m: float

    def camera(self, grid: Grid, width_px: int, height_px: int) -> Camera:
        """Return the camera."""
        return replace(parse_camera(self.spec, grid, width_px, height_px), near_m=self.near_m)


@dataclass(frozen=True, slots=True)
class Lamp:
    """The light inside."""

    light: Light
    at: F64
    """``(3,)`` [m], level frame."""
    n_blocked: int
    """Of 26 rays in all directions, those that meet something: 26 in a closed space."""


@dataclass(frozen=True, slots=True, eq=False)
class Sights:
    """Candidates for a view; level frame."""

    eyes: F64
    """``(n, 3)`` [m]"""
    forward: F64
    """``(n, 3)``, unit."""
    fov_deg: float
    least_m: float
    """What is nearer than this spoils a view,"""
    most_m: float
    """and what is farther away is no better than sky with some surface in it."""

    def part(self, begin: int, end: int) -> Sights:
        """Return some of them."""
        return replace(self, eyes=self.eyes[begin:end], forward=self.forward[begin:end])


class Chooser:
    """Views and lights of one model."""

    def __init__(self, mesh: Mesh, grid: Grid) -> None:
        self.place = Place.of(mesh)
        self._grid, self._positions = grid, mesh.positions
        self._lamp: Lamp | None = None
        self._streets: F64 | None = None
        self._specs: dict[tuple[str, str], str] = {}

    @property
    def lamp(self) -> Lamp:
        """The light inside, looked for once."""
        if self._lamp is None:
            self._lamp = self._find_lamp()
        return self._lamp

    def light(self, name: str) -> Light:
        """Return the light of that name."""
        if name == LAMP:
            return self.lamp.light
        azimuth, altitude = (math.radians(angle) for angle in SUNS[name])
        level = np.array(
            [
                math.sin(azimuth) * math.cos(altitude),
                math.cos(azimuth) * math.cos(altitude),
                math.sin(altitude),
            ]
        )
        x, y, z = self.place.in_cache_frame(level).tolist()
        if np.array_equal(self.place.axes, np.eye(3)):
            spec = f"dir:{SUNS[name][0]:g},{SUNS[name][1]:g}"
        else:
            spec = f"dir:{math.degrees(math.atan2(x, y)):.4f},{math.degrees(math.asin(z)):.4f}"
        return parse_light(spec)

    def view(self, name: str, light_name: str) -> View:
        """Return the view of that name; two of them are others by other lights."""
        part = self.place.eye_m / EYE_M
        near_m = part * (_NEAR_CUT_M if name == "near plane" else DEFAULT_NEAR_M)
        by = ""  # only these depend on the light
        if name == "in shadow" or (name == "inside" and light_name == LAMP):
            by = light_name
        if (name, by) not in self._specs:
            self._specs[name, by] = self._found(name, light_name, near_m)
        return View(name, self._specs[name, by], near_m)

    def _found(self, name: str, light_name: str, near_m: float) -> str:
        """Return the best camera for a view, as the command line takes it."""
        match name:
            case "street":
                return self._best(self._from_streets(8, 2.0))
            case "inside":
                return self._inside(by_lamp=light_name == LAMP)
            case "in shadow":
                return self._in_shadow(self.light(light_name).in_cache_frame(self._grid))
            case "near plane":
                return self._near_plane(near_m)
            case "oblique":
                return self._best(self._from_above(8.0, 1.5, 30.0))
        return self._best(self._from_above(50.0, 1.6, 45.0))

    def _spec(self, eye: F64, forward: F64, fov_deg: float) -> str:
        """Return a sight as the command line takes it, in input coordinates [m]."""
        target = eye + 10.0 * self.place.eye_m * forward
        ends = [self.place.in_cache_frame(p) + self._grid.origin_m for p in (eye, target)]
        numbers = [f"{value:.6f}".rstrip("0").rstrip(".") for end in ends for value in end]
        return ",".join([*numbers, f"{fov_deg:g}"])

    # ------------------------------------------------------------ candidates

    @property
    def streets(self) -> F64:
        """Eyes ``(n, 3)`` above open ground near the middle, level frame."""
        if self._streets is None:
            self._streets = self._find_streets()
        return self._streets

    def _find_streets(self) -> F64:
        place = self.place
        x, y = place.around(0.6, 15)
        ground = place.grounds(x, y)
        ring = compass(8) * 12.0 * place.eye_m
        around = place.grounds(
            (x[:, None] + ring[:, 0]).ravel(), (y[:, None] + ring[:, 1]).ravel()
        ).reshape(-1, 8)
        is_street = ground <= np.median(around, axis=1) + place.eye_m
        eyes = np.column_stack([x, y, ground + place.eye_m])
        return eyes[is_street] if is_street.any() else eyes

    def _from_streets(self, n: int, pitch_deg: float) -> Sights:
        eye_m = self.place.eye_m
        return _each(self.streets, compass(n, pitch_deg), 2.0 * eye_m, 60.0 * eye_m)

    def _from_above(self, down_deg: float, reaches: float, fov_deg: float) -> Sights:
        place = self.place
        target = place.middle + [0.0, 0.0, place.eye_m]
        away = reaches * place.reach_m
        forward = compass(16, -down_deg)
        return Sights(target - away * forward, forward, fov_deg, 0.2 * away, 3.0 * away)

    def _inside(self, *, by_lamp: bool) -> str:
        """Return the view from a courtyard, or from the room that the lamp is in."""
        eye_m = self.place.eye_m
        courtyard = None if by_lamp else self._courtyard()
        at = self.lamp.at if courtyard is None else courtyard
        around = compass(24)
        _, distance = self.place.hits(np.broadcast_to(at, around.shape), around)
        free = np.minimum(distance, 30.0 * eye_m)
        # Back against the farthest wall, looking at the middle of the space.
        farthest = np.argsort(-free, kind="stable")[:6]
        eyes = np.repeat(at + 0.85 * (free[:, None] * around)[farthest], 3, axis=0)
        forward = np.repeat(-around[farthest], 3, axis=0)
        forward[:, 2] += np.tile([0.0, -0.15, 0.15], len(farthest))
        forward /= np.linalg.norm(forward, axis=1)[:, None]
        return self._best(Sights(eyes, forward, DEFAULT_FOV_DEG, 0.3 * eye_m, 60.0 * eye_m))

    def _courtyard(self) -> F64 | None:
        """Return the eye in the most closed space under the open sky, if there is one."""
        place = self.place
        x, y = place.around(1.0, 25)
        eyes = np.column_stack([x, y, place.grounds(x, y) + place.eye_m])
        around = compass(24)
        starts = np.repeat(eyes, 24, axis=0)
        _, distance = place.hits(starts, np.tile(around, (len(eyes), 1)))
        distance = distance.reshape(-1, 24)
        n_walls = (distance < 40.0 * place.eye_m).sum(axis=1)
        is_roomy = distance.min(axis=1) > 1.5 * place.eye_m
        is_roof = eyes[:, 2] > np.median(self.streets[:, 2]) + 2.0 * place.eye_m
        score = n_walls + 0.5 * is_roomy - 4.0 * is_roof
        best = int(np.argmax(score))
        return eyes[best] if n_walls[best] >= _FEWEST_WALLS else None

    def _in_shadow(self, light: F32) -> str:
        """Return a view from where the light does not reach, of light and shadow."""
        place, at = self.place, self.lamp.at
        rays = all_around()
        _, free = place.hits(np.broadcast_to(at, rays.shape), rays)
        free = np.minimum(free, place.reach_m)
        steps = [at + (part * free)[:, None] * rays for part in (0.4, 0.8, 1.1, 1.4)]
        x, y = place.around(1.0, 11)
        heights = np.linspace(place.low[2], place.high[2], 7)[1:-1]
        filled = [np.column_stack([x, y, np.full(len(x), z)]) for z in heights]
        for eyes in (np.concatenate([self.streets, *steps]), np.concatenate(filled)):
            dark = eyes[place.is_in_shadow(eyes, light)]
            if len(dark):
                break
        else:
            dark = self._behind_faces(light)
        eye_m = place.eye_m
        return self._best(_each(dark, compass(8, -8.0), 1.5 * eye_m, 60.0 * eye_m), [light])

    def _behind_faces(self, light: F32) -> F64:
        """Return eyes behind what the light shines on, seen from it: surely in shadow."""
        place = self.place
        towards = light[:3].astype(np.float64) @ place.axes.T
        if light[3] != 0.0:
            towards = towards - place.middle
        towards /= np.linalg.norm(towards)
        x, y = place.around(1.0, 25)
        tops = np.column_stack([x, y, place.grounds(x, y)])
        return tops - 2.0 * place.eye_m * towards

    def _near_plane(self, near_m: float) -> str:
        """Return a view along a wall that the near plane cuts, the wall at one side."""
        place = self.place
        around = compass(16)
        starts = np.repeat(self.streets, 16, axis=0)
        towards = np.tile(around, (len(self.streets), 1))
        face, distance = place.hits(starts, towards)
        is_hit = (face >= 0) & (distance > place.eye_m) & (distance < 30.0 * place.eye_m)
        normal = place.normals[face] @ place.axes.T
        is_wall = is_hit & (np.abs(normal[:, 2]) < 0.3)
        if not is_wall.any():
            return self._near_ground(near_m)
        rows = np.flatnonzero(is_wall)
        rows = rows[:: max(1, len(rows) // 300)]
        point = starts[rows] + distance[rows, None] * towards[rows]
        normal = normal[rows]
        normal *= -np.sign(np.einsum("ij,ij->i", normal, towards[rows]))[:, None]
        eyes = np.repeat(point + 0.2 * near_m * normal, 2, axis=0)
        along = np.cross(normal, [0.0, 0.0, 1.0])
        along /= np.linalg.norm(along, axis=1)[:, None]
        both = np.stack([along, -along], axis=1).reshape(-1, 3)
        forward = math.cos(_YAW) * both + math.sin(_YAW) * np.repeat(normal, 2, axis=0)
        sights = Sights(eyes, forward, DEFAULT_FOV_DEG, 0.0, 60.0 * place.eye_m)
        return self._best(sights, cut_m=near_m)

    def _near_ground(self, near_m: float) -> str:
        """Return a view along ground that the near plane cuts, where there are no walls."""
        eye_m = self.place.eye_m
        eyes = self.streets - [0.0, 0.0, eye_m - 0.2 * near_m]
        return self._best(_each(eyes, compass(8, 10.0), 0.0, 60.0 * eye_m), cut_m=near_m)

    # ------------------------------------------------------------ choosing

    def _best(
        self, sights: Sights, lights: list[F32] | None = None, cut_m: float | None = None
    ) -> str:
        """Return the sight that shows most, the first of equal ones.

        Both light and shadow of `lights`, by default the suns; with `cut_m`, surface before
        that view depth.
        """
        if lights is None:
            lights = [self.light(name).in_cache_frame(self._grid) for name in SUNS]
        n = len(sights.eyes)
        scores = np.concatenate(
            [
                self._scores(sights.part(begin, begin + _AT_ONCE), lights, cut_m)
                for begin in range(0, n, _AT_ONCE)
            ]
        )
        # Rounded, so that no machine's last bit chooses.
        best = int(np.argmax(scores.round(9)))
        return self._spec(sights.eyes[best], sights.forward[best], sights.fov_deg)

    def _scores(self, sights: Sights, lights: list[F32], cut_m: float | None) -> F64:
        """Return how much sights show: surface at good distances, edges, light and shadow."""
        rays = _rays(sights)
        eyes = np.broadcast_to(sights.eyes[:, None], rays.shape)
        face, depth = self._seen(eyes, rays)
        scores = np.zeros(len(rays))
        if cut_m is not None:
            share = (depth < cut_m).mean(axis=1)
            scores += np.where((share > 0.005) & (share < 0.2), 2.0, -2.0)
            face, behind = self._seen(eyes + cut_m * rays, rays)
            depth = cut_m + behind
        is_hit = np.isfinite(depth)
        is_good = (depth > sights.least_m) & (depth < sights.most_m)
        scores += np.minimum(is_hit.mean(axis=1), _ENOUGH_SURFACE)
        scores += np.minimum(is_good.mean(axis=1), _ENOUGH_SURFACE)
        scores -= 2.0 * (depth < sights.least_m).mean(axis=1)
        scores += np.minimum(self._edges(rays, face, depth), _ENOUGH_EDGES) / _ENOUGH_EDGES
        points = (eyes + (depth * (1.0 - 1e-3))[..., None] * rays)[is_hit]
        n_hit = np.maximum(is_hit.sum(axis=1), 1)
        for light in lights:
            is_dark = np.zeros(is_hit.shape, bool)
            is_dark[is_hit] = self.place.is_in_shadow(points, light)
            dark = is_dark.sum(axis=1) / n_hit
            scores += 4.0 * dark * (1.0 - dark) / len(lights)
        return scores

    def _seen(self, starts: F64, rays: F64) -> tuple[I32, F64]:
        """Return faces and view depths of rays ``(n, n_rays, 3)``."""
        face, depth = self.place.hits(starts.reshape(-1, 3), rays.reshape(-1, 3))
        return face.reshape(rays.shape[:2]), depth.reshape(rays.shape[:2])

    def _edges(self, rays: F64, face: I32, depth: F64) -> F64:
        """Return the shares of neighbours in coarse pictures that see different planes."""
        columns, rows = _COARSE
        shape = (len(rays), rows, columns)
        normal = (self.place.normals[face] @ self.place.axes.T).reshape(*shape, 3)
        far = np.where(np.isfinite(depth), depth, 0.0).reshape(shape)
        point = far[..., None] * rays.reshape(*shape, 3)
        step = point[:, :, 1:] - point[:, :, :-1]
        off = np.abs(np.einsum("nijk,nijk->nij", normal[:, :, :-1], step))
        turned = np.abs(np.einsum("nijk,nijk->nij", normal[:, :, :-1], normal[:, :, 1:])) < 0.98
        is_edge = turned | (off > 0.02 * far[:, :, :-1])
        return (is_edge & (face.reshape(shape)[:, :, :-1] >= 0)).mean(axis=(1, 2))

    # ------------------------------------------------------------ the lamp

    def _find_lamp(self) -> Lamp:
        """Return the light in the closed space nearest to the middle, or in the most closed."""
        place = self.place
        x, y = place.around(1.0, 41)
        levels = self._levels(x, y)
        below, above = levels[:, 1:], levels[:, :-1]
        with np.errstate(invalid="ignore"):
            column, gap = np.nonzero(above - below > 1.2 * place.eye_m)
        z = (below[column, gap] + above[column, gap]) / 2.0
        spots = np.column_stack([x[column], y[column], z])
        if not len(spots):
            spots = self.streets
        rays = all_around()
        starts = np.repeat(spots, len(rays), axis=0)
        _, distance = place.hits(starts, np.tile(rays, (len(spots), 1)))
        distance = distance.reshape(len(spots), -1)
        n_blocked = np.isfinite(distance).sum(axis=1)
        is_tight = distance.min(axis=1) < 0.3 * place.eye_m
        away = np.linalg.norm((spots - place.middle)[:, :2], axis=1)
        best = int(np.lexsort((away, is_tight, -n_blocked))[0])
        return Lamp(self._off_vertices(spots[best]), spots[best], int(n_blocked[best]))

    def _levels(self, x: F64, y: F64) -> F64:
        """Return the heights of the first surfaces from above, ``(n, 8)``, NaN for none."""
        place = self.place
        z = np.full(len(x), place.high[2] + place.eye_m)
        levels = np.full((len(x), 8), np.nan)
        down = np.broadcast_to([0.0, 0.0, -1.0], (len(x), 3))
        for i in range(levels.shape[1]):
            _, distance = place.hits(np.column_stack([x, y, z]), down)
            z = z - np.where(np.isfinite(distance), distance, 0.0)
            levels[:, i] = np.where(np.isfinite(distance), z, np.nan)
            z = z - 1e-3 * place.eye_m
        return levels

    def _off_vertices(self, at: F64) -> Light:
        """Return a point light there, a little to the side of a vertex."""
        while True:
            x, y, z = (self.place.in_cache_frame(at) + self._grid.origin_m).tolist()
            light = parse_light(f"point:{x:.4f},{y:.4f},{z:.4f}")
            if not _is_vertex(light.in_cache_frame(self._grid), self._positions):
                return light
            at = at + 0.01 * self.place.eye_m


_YAW: Final = math.radians(15.0)
"""Of the view along a wall, away from it."""


def _each(eyes: F64, forward: F64, least_m: float, most_m: float) -> Sights:
    """Return sights from each of `eyes` each way."""
    return Sights(
        np.repeat(eyes, len(forward), axis=0),
        np.tile(forward, (len(eyes), 1)),
        DEFAULT_FOV_DEG,
        least_m,
        most_m,
    )


def _is_vertex(light: F32, positions: F32) -> bool:
    return bool((positions == light[:3]).all(axis=1).any())


def _rays(sights: Sights) -> F64:
    """Return rays of view depth 1 through coarse pictures ``(n, n_rays, 3)``, level frame."""
    columns, rows = _COARSE
    right = np.cross(sights.forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1)[:, None]
    up = np.cross(right, sights.forward)
    half = math.tan(math.radians(sights.fov_deg) / 2.0)
    x = ((np.arange(columns) + 0.5) / columns * 2.0 - 1.0) * half * _ASPECT
    y = ((np.arange(rows) + 0.5) / rows * 2.0 - 1.0) * half
    across, along = (grid.ravel()[:, None] for grid in np.meshgrid(x, y))
    return sights.forward[:, None] + across * right[:, None] + along * up[:, None]

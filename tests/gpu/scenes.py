"""What tests of pictures share: small scenes, cameras and lights in source coordinates.

`Stage` keeps programs and targets between scenes. `every_setting` is each way to draw the
same shadows; `problems_of` draws a view in all of them and says what differs from the judge.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from svprep.light import parse_lights
from svprep.model import Prepared, SourceMesh
from svprep.pipeline import BuildConfig, prepare
from svprep.reference.volumes import volume_count
from svprep_runtime.camera import Camera, look_at
from svprep_runtime.context import Context
from svprep_runtime.frame import METHODS, Picture, Settings, render
from svprep_runtime.judge import Judge, Truth, compare
from svprep_runtime.programs import Programs
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets
from svprep_runtime.volumes import CastersOf, casters_of
from tests.property.meshes import side_by_side

SIZE = (64, 64)
CONSTRUCTIONS = ("vertex", "geometry", "triangles")
COUNTERS = ("float", "stencil")


@dataclass
class Stage:
    """A context with the programs and targets that its scenes share."""

    context: Context
    programs: Programs = field(init=False)
    _targets: dict[tuple[int, int, int], Targets] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.programs = Programs(self.context)

    @contextlib.contextmanager
    def scene(self, prepared: Prepared) -> Iterator[Scene]:
        with Scene(self.context, prepared) as scene:
            own = scene.programs
            scene.programs = self.programs
            try:
                yield scene
            finally:
                scene.programs = own

    def targets(self, width_px: int, height_px: int, n_lights: int = 1) -> Targets:
        key = (width_px, height_px, n_lights)
        if key not in self._targets:
            self._targets[key] = Targets(self.context, *key)
        return self._targets[key]

    def draw(
        self, scene: Scene, camera: Camera, lights: Sequence[np.ndarray], settings: Settings
    ) -> tuple[Picture, np.ndarray]:
        """Return a picture, and the count of the last light as the counter has it."""
        targets = self.targets(camera.width_px, camera.height_px, len(lights))
        picture = render(scene, targets, camera, lights, settings)
        is_float = settings.counter == "float"
        return picture, targets.read_count() if is_float else targets.read_stencil()

    def release(self) -> None:
        for targets in self._targets.values():
            targets.release()
        self.programs.release()


def built(*objects: SourceMesh, lights: Sequence[str] = ()) -> Prepared:
    """Return a prepared city of `objects`, clamped for `lights`."""
    return prepare(side_by_side(*objects), BuildConfig(), lights=parse_lights(lights))


def light_of(prepared: Prepared, spec: str) -> np.ndarray:
    return parse_lights([spec])[0].in_cache_frame(prepared.mesh.grid)


def camera_of(
    prepared: Prepared, eye: object, target: object, size: tuple[int, int] = SIZE, **kw: float
) -> Camera:
    """Return a camera, its eye and target given in source coordinates."""
    origin = prepared.mesh.grid.origin_m
    return look_at(np.array(eye, float) - origin, np.array(target, float) - origin, *size, **kw)


def truth_of(prepared: Prepared, camera: Camera, light: np.ndarray) -> Truth:
    return Judge(prepared.mesh, prepared.planes, prepared.object_names).truth(camera, light)


def every_setting(
    methods: Sequence[str] = METHODS,
    constructions: Sequence[str] = CONSTRUCTIONS,
    counters: Sequence[str] = COUNTERS,
    clamps: Sequence[bool] = (False,),
) -> list[Settings]:
    return [
        Settings(method=m, construction=c, counter=n, clamp=k)
        for m, c, n, k in product(methods, constructions, counters, clamps)
    ]


def rays_of(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return eye ``(3,)`` and directions ``(h, w, 3)``, of view depth 1."""
    y, x = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    rays = camera.directions(x.ravel(), y.ravel())
    return camera.eye.astype(float), rays.reshape(camera.height_px, camera.width_px, 3)


def count_expected(
    prepared: Prepared, casters: CastersOf, camera: Camera, truth: Truth, robust: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return how many faces that cast stand between what is seen and the light, and where sure.

    What is seen is displaced to the eye's side, as the judge does it. Sure are pixels whose
    eight neighbours see the same face and have the same count. `robust`: all faces cast,
    whatever the volumes that were drawn.
    """
    mesh = prepared.mesh
    eye, rays = rays_of(camera)
    rows = np.argwhere(truth.is_decidable)
    at = tuple(rows.T)
    corners = mesh.positions[mesh.faces[truth.face[at]]].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = ((eye - corners[:, 0]) * normal).sum(axis=1)
    depth = height / -(normal * rays[at]).sum(axis=1)
    x = eye + depth[:, None] * rays[at] + 0.002 * np.sign(height)[:, None] * normal
    s = casters.facing if robust else np.where(casters.counts, casters.facing, 0)
    found = volume_count(mesh.positions, mesh.faces, s, casters.light, x)
    value = np.full(truth.face.shape, -1)
    value[at] = np.where(found.is_decidable, found.value, -1)
    is_sure = (value >= 0) & ~is_near_a_change(value) & ~is_near_a_change(truth.face)
    return value, is_sure


def is_near_a_change(values: np.ndarray) -> np.ndarray:
    """Return the pixels that differ from one of their eight neighbours, and the frame."""
    h, w = values.shape
    padded = np.pad(values, 1, constant_values=-2)
    parts = [padded[i : i + h, j : j + w] for i in range(3) for j in range(3)]
    return np.any([part != values for part in parts], axis=0)


def problems_of(
    stage: Stage,
    prepared: Prepared,
    camera: Camera,
    light: np.ndarray,
    settings: Sequence[Settings],
    *,
    counts: bool = True,
) -> list[str]:
    """Return what is wrong with pictures of one view: nothing, let us hope.

    Masks equal the judge's wherever it is sure, no count is below 0 anywhere, and counts of
    whole volumes are the number of faces (if `counts`), modulo 256 in the stencil.
    """
    truth = truth_of(prepared, camera, light)
    assert truth.is_decidable.any(), "a view that shows nothing decidable tests nothing"
    if counts:
        expected, is_sure = count_expected(prepared, casters_of(prepared, light), camera, truth)
        assert ((expected > 0) <= truth.in_shadow)[is_sure].all()
    problems = []
    with stage.scene(prepared) as scene:
        for one in settings:
            picture, count = stage.draw(scene, camera, [light], one)
            found = compare(truth, picture.mask, picture.is_surface)
            what = f"{one.method} {one.construction} {one.counter} clamp={one.clamp}"
            if found.n_differing or found.n_shadow_in_sky:
                problems.append(
                    f"{what}: {found.n_differing} of {found.n_decidable} differ, in the sky "
                    f"{found.n_shadow_in_sky}; first {found.differing[:3].tolist()}"
                )
            tally = picture.tallies[0]
            n_below = int((count < 0).sum())  # the stencil has no sign, and tallies none
            if (tally.n_negative, tally.highest_count) != (n_below, max(int(count.max()), 0)):
                problems.append(f"{what}: {tally}, found {n_below} and {count.max()}")
            if n_below:
                problems.append(f"{what}: {n_below} counts below 0")
            if counts and not (one.clamp and len(prepared.clamp)):
                asked = expected % 256 if one.counter == "stencil" else expected
                wrong = is_sure & (count != asked)
                if wrong.any():
                    i, j = np.argwhere(wrong)[0].tolist()
                    problems.append(
                        f"{what}: {wrong.sum()} counts differ, first at {i}, {j}: "
                        f"{count[i, j]}, expected {asked[i, j]}"
                    )
    return problems

"""Judge all shots of a model: truths by rays, pictures by the runtime, one by one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shadow_judging.datasets import Ready, with_lights
from shadow_judging.plan import Shot
from shadow_judging.store import MOST_PIXELS_LISTED, Result, Store, picture_key
from shadow_judging.views import LIGHTS, Chooser, View
from svprep.cache.reader import Cache, open_cache
from svprep.model import F32, U8
from svprep_runtime.camera import Camera
from svprep_runtime.context import Context
from svprep_runtime.frame import Picture, render, to_srgb
from svprep_runtime.judge import Judge
from svprep_runtime.judge_causes import causes_of
from svprep_runtime.judge_report import Truth, compare, difference_picture
from svprep_runtime.scene import Scene
from svprep_runtime.targets import Targets

OVERLAPS_LISTED = 3


@dataclass(frozen=True, slots=True)
class Judged:
    """A model's results."""

    name: str
    is_conformance: bool
    n_faces: int
    n_objects: int
    lamp_blocked: int
    """Of 26 rays around the lamp, those that meet something."""
    results: list[Result] = field(default_factory=list)


class Session:
    """What the pictures of all models share."""

    def __init__(
        self,
        context: Context,
        store: Store,
        work: Path,
        size: tuple[int, int],
        on_shot: Callable[[str], None],
        pictures: Path | None = None,
    ) -> None:
        self.context, self.store, self.work = context, store, work
        self.size, self.on_shot, self.pictures = size, on_shot, pictures

    def judge(self, ready: Ready, shots: Sequence[Shot]) -> Judged:
        """Return the results of `shots`, kept ones where they are there."""
        with open_cache(ready.cache) as cache:
            chooser = Chooser(cache.mesh, cache.grid)
            specs = {name: chooser.light(name).spec for name in LIGHTS}
            judged = Judged(
                ready.source.name,
                ready.source.is_conformance,
                cache.n_faces,
                cache.n_objects,
                chooser.lamp.n_blocked,
            )
        lit = with_lights(ready, [specs[name] for name in {shot.light: 0 for shot in shots}],
                          self.work)  # fmt: skip
        with open_cache(lit) as cache:
            of_model = _OfModel(self, ready, cache, chooser)
            try:
                judged.results.extend(of_model.result(shot) for shot in shots)
            finally:
                of_model.release()
        return judged


class _OfModel:
    """One model on its way: what takes long is made when it is asked for."""

    def __init__(self, session: Session, ready: Ready, cache: Cache, chooser: Chooser) -> None:
        self._session, self._ready, self._cache, self._chooser = session, ready, cache, chooser
        self._judge: Judge | None = None
        self._drawn: tuple[Scene, Targets] | None = None
        self._light: F32 | None = None
        self._views: dict[tuple[str, str], View] = {}
        self._truth: tuple[str, Truth] | None = None

    def release(self) -> None:
        """Give graphics memory back."""
        if self._drawn:
            for one in self._drawn:
                one.release()

    def result(self, shot: Shot) -> Result:
        """Return one result, kept or new."""
        both = (shot.view, shot.light)
        if both not in self._views:
            self._views[both] = self._chooser.view(*both)
        view = self._views[both]
        camera = view.camera(self._cache.grid, *self._session.size)
        spec = self._chooser.light(shot.light)
        light = spec.in_cache_frame(self._cache.grid)
        key = picture_key(self._ready.digest, camera, light)
        kept = self._session.store.result(key, shot)
        if kept:
            self._session.on_shot(f"{self._ready.source.name}: kept")
            return kept
        self._session.on_shot(f"{self._ready.source.name}: {shot.view}, {shot.light}, {shot.way}")
        truth, truth_s = self._truth_of(key, camera, light)
        began = time.perf_counter()
        picture = self._draw(camera, light, shot)
        draw_s = time.perf_counter() - began
        mask = np.where(picture.in_shadow[0], 255, 0).astype(np.uint8)
        compared = compare(truth, mask, picture.is_surface)
        at = compared.differing[:MOST_PIXELS_LISTED]
        tally = picture.tallies[0]
        result = Result(
            dataset=self._ready.source.name,
            shot=shot,
            size=self._session.size,
            camera_spec=view.spec,
            near_m=view.near_m,
            light_spec=spec.spec,
            n_surface=compared.n_surface,
            n_decidable=compared.n_decidable,
            n_differing=compared.n_differing,
            differing=[[int(x), int(y), int(mask[y, x] > 0)] for y, x in at],
            n_negative=tally.n_negative,
            n_shadow_in_sky=compared.n_shadow_in_sky,
            highest_count=tally.highest_count,
            n_clamped_segments=tally.n_clamped_segments,
            overlaps=[[*one.names, one.pixels] for one in truth.overlaps[:OVERLAPS_LISTED]],
            causes=causes_of(self._cache.mesh, self._cache.planes, camera, light, truth, mask, at),
            truth_s=truth_s,
            draw_s=draw_s,
        )
        self._session.store.add(key, shot, result)
        if self._session.pictures and shot.part == "once":
            self._save(self._session.pictures, shot, picture, truth, mask)
        return result

    def _truth_of(self, key: str, camera: Camera, light: F32) -> tuple[Truth, float]:
        """Return what rays say, and how long they took."""
        if self._truth and self._truth[0] == key:
            return self._truth[1], 0.0
        truth, took_s = self._session.store.truth(key), 0.0
        if truth is None:
            if self._judge is None:
                cache = self._cache
                self._judge = Judge(cache.mesh, cache.planes, cache.object_names)
            began = time.perf_counter()
            truth = self._judge.truth(camera, light)
            took_s = time.perf_counter() - began
            self._session.store.add_truth(key, truth)
        self._truth = key, truth
        return truth, took_s

    def _draw(self, camera: Camera, light: F32, shot: Shot) -> Picture:
        if self._drawn is None:
            scene = Scene(self._session.context, self._cache)
            self._drawn = scene, Targets(self._session.context, *self._session.size, 1)
        scene, targets = self._drawn
        if self._light is not None and not np.array_equal(self._light, light):
            scene.forget(self._light)
        self._light = light
        return render(scene, targets, camera, [light], shot.settings)

    def _save(self, folder: Path, shot: Shot, picture: Picture, truth: Truth, mask: U8) -> None:
        from PIL import Image

        words = [self._ready.source.name, shot.view, shot.light, *shot.way.split(", ")]
        name = "_".join(words).replace("/", "-").replace(" ", "-")
        folder.mkdir(parents=True, exist_ok=True)
        pair = np.hstack([to_srgb(picture.radiance), difference_picture(truth, mask)])
        Image.fromarray(pair).save(folder / f"{name}.png")

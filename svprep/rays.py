"""Rays against all faces of a mesh, by Embree: shared by sun hours and the judge.

Embree traces in float32 [1]_, its robust mode without gaps: a ray through an edge or a
vertex that faces share meets at least one of them (Woop, Benthin, Wald 2013 [2]_). The
answer of a ray depends on nothing but the ray and the faces, so neither batches nor
threads change it.

    a ray starts at X displaced along its face's unit normal, in float64, by

        offset = max(1 mm, 4 ulp)      ulp: the float32 step at the largest coordinate

    and is rounded to float32, which moves it by less than one ulp. It cannot meet
    its own face, whatever the sun, except for suns that graze the face by less than
    2e-4 rad, for which no shadow is decidable (`svprep.model.MOST_TILT_RAD`). What
    stands closer to a surface than the offset casts no shadow on it; at a sharp inner
    edge, within the offset of it, a ray may start behind the other face.

References
----------
.. [1] Wald, Woop, Benthin, Johnson, Ernst 2014, Embree: A Kernel Framework for Efficient
   CPU Ray Tracing.
.. [2] Woop, Benthin, Wald 2013, Watertight Ray/Triangle Intersection.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from svprep.errors import require_extra
from svprep.model import BOOL, F32, F64, I32, Mesh
from svprep.parallel import thread_count

if TYPE_CHECKING:
    from collections.abc import Callable

LEAST_OFFSET_M: Final = 1e-3
OFFSET_ULPS: Final = 4.0
RAYS_AT_ONCE: Final = 1 << 15
"""Points of a batch: few enough that what is derived from them stays in a core's cache."""


def offset_m(mesh: Mesh, least_m: float = LEAST_OFFSET_M, ulps: float = OFFSET_ULPS) -> float:
    """Return how far before its face a ray starts [m]: ``max(least_m, ulps * ulp)``.

    An ulp is the step of float32 at the mesh's largest coordinate.
    """
    largest = float(np.abs(mesh.positions).max()) if len(mesh.positions) else 0.0
    return max(least_m, ulps * float(np.spacing(np.float32(largest))))


def require_embree(purpose: str) -> None:
    """Raise unless Embree is there.

    Parameters
    ----------
    purpose : str
        What needs it, as the message's first words: ``"svprep hours"``.

    Raises
    ------
    EnvironmentProblem
        It is not: names the install command.
    """
    try:
        import embreex.rtcore_scene  # noqa: F401
    except ImportError:
        raise require_extra("embreex", "judge", purpose) from None


class Scene:
    """All faces of a mesh, ready for rays; safe to use from several threads at once.

    Building takes about 1.5 us a face; each `faces` row that a ray meets is named by
    its index. Directions need not be of length 1; distances are in units of their
    lengths.
    """

    def __init__(self, positions: F32, faces: np.ndarray, device: object = None) -> None:
        require_embree("tracing rays")
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore import EmbreeDevice
        from embreex.rtcore_scene import EmbreeScene

        self.device: Any = device or EmbreeDevice()
        self._scene: Any = EmbreeScene(self.device, robust=True)
        self._is_empty = len(faces) == 0
        if self._is_empty:
            return
        self._mesh = TriangleMesh(
            self._scene, np.array(positions, np.float32), np.array(faces, np.int32)
        )
        # The first ray commits the scene, which no two threads may do at once.
        self.is_blocked(np.zeros((1, 3), np.float32), np.array([0.0, 0.0, 1.0], np.float32))

    def is_blocked(self, origins: F32, directions: F32, far: F32 | None = None) -> BOOL:
        """Return ``(n,) bool``: whether a face lies on each ray.

        Parameters
        ----------
        origins : ndarray
            ``(n, 3) float32``, C-contiguous.
        directions : ndarray
            ``(3,)`` of all rays, or ``(n, 3)``; float32, C-contiguous.
        far : ndarray, optional
            ``(n,) float32``: where each ray ends, inclusive; without it none does.
        """
        if self._is_empty or len(origins) == 0:
            return np.zeros(len(origins), bool)
        ends = {} if far is None else {"dists": far}
        met = self._scene.run(origins, directions.reshape(-1, 3), query="OCCLUDED", **ends)
        return np.asarray(met >= 0)

    def first_hit(self, origins: F32, directions: F32, far: F32 | None = None) -> tuple[I32, F32]:
        """Return the first face on each ray, -1 for none, and how far away it is.

        Parameters
        ----------
        origins, directions : ndarray
            ``(n, 3) float32``, C-contiguous.
        far : ndarray, optional
            ``(n,) float32``: as for `is_blocked`.
        """
        if self._is_empty or len(origins) == 0:
            return np.full(len(origins), -1, np.int32), np.full(len(origins), np.inf, np.float32)
        ends = {} if far is None else {"dists": far}
        found = self._scene.run(origins, directions, query="INTERSECT", output=1, **ends)
        return found["primID"], found["tfar"]

    def vertical(self, origins: F32, up: float) -> tuple[I32, F32]:
        """Return the same of rays straight up (1.0) or down (-1.0)."""
        directions = np.zeros_like(origins)
        directions[:, 2] = up
        return self.first_hit(origins, directions)


def for_batches(
    n: int, size: int, work: Callable[[int, int], None], on_done: Callable[[int], None]
) -> None:
    """Call ``work(begin, end)`` for batches of `size` of n items, on `thread_count` threads.

    `work` writes what belongs to its items and nothing else, so that their order does
    not matter. ``on_done(n_done)`` is told here, in the calling thread, after each.
    """
    starts = range(0, n, size)
    n_threads = min(thread_count(), len(starts))
    done = 0
    if n_threads < 2:
        for begin in starts:
            work(begin, min(begin + size, n))
            on_done(min(begin + size, n))
        return
    pool = ThreadPoolExecutor(n_threads, thread_name_prefix="svprep-rays")
    try:
        sizes = {
            pool.submit(work, begin, min(begin + size, n)): min(size, n - begin) for begin in starts
        }
        for future in as_completed(sizes):
            future.result()
            done += sizes[future]
            on_done(done)
    finally:
        pool.shutdown(cancel_futures=True)


def displaced(position: F64, unit_normal: F64, offset: float) -> F32:
    """Return ``(n, 3) float32``: where rays start, displaced in float64, then rounded."""
    return (position + offset * unit_normal).astype(np.float32)

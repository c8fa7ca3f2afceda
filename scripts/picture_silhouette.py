"""Draw the silhouette that a light sees as a picture: docs/silhouette.png.

    python scripts/picture_silhouette.py                       the sample city
    python scripts/picture_silhouette.py city.svp.h5 -o a.png --light dir:200,30

A depth buffer hides what is hidden and a second one, seen from the light, tells
sun from shadow: good enough for a picture, and nothing here is used for more. The
edges are those of `svprep silhouette`. The same cache gives the same picture.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter

import svprep
from svprep.cache.reader import Cache
from svprep.errors import InputError, SvprepError, require_extra
from svprep.facing import facing
from svprep.light import Light, parse_light
from svprep.silhouette import silhouette

try:
    from PIL import Image, ImageDraw
except ImportError:
    raise SystemExit(str(require_extra("Pillow", "view", "drawing a picture"))) from None

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "data" / "small_city.obj.gz"
SUPERSAMPLING = 4
DRAWN_LINE_PX = 1.5
SHADOW_MAP_PX = 5000

SKY = (225, 233, 241)
SUNLIT = np.array([250.0, 247.0, 240.0])
SHADE = np.array([130.0, 138.0, 154.0])
GROUND_TINT = np.array([0.90, 0.93, 0.87])
LINE = (214, 40, 40)


@dataclass(frozen=True, slots=True)
class View:
    """A parallel projection: ``(x, y)`` in pixels, y down, and depth [m], growing away."""

    image_from_cache: np.ndarray
    """``(3, 4)``: affine, from homogeneous cache positions."""
    width_px: int
    height_px: int

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return ``(..., 3)``: x, y [px] and depth [m] of points ``(..., 3)``."""
        affine = self.image_from_cache
        return points.astype(np.float64) @ affine[:, :3].T + affine[:, 3]


def parallel_view(
    towards_eye: np.ndarray, target: np.ndarray, width_m: float, size_px: tuple[int, int]
) -> View:
    """Return the view from a direction of what lies around `target`, upright."""
    back = towards_eye / np.linalg.norm(towards_eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    scale = size_px[0] / width_m
    linear = np.stack([right * scale, -up * scale, -back])
    middle = np.array([size_px[0] / 2, size_px[1] / 2, 0.0])
    return View(np.column_stack([linear, middle - linear @ target]), *size_px)


def draw_depth(view: View, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return depth [m] (inf: nothing) and nearest triangle (-1) of each pixel.

    ``corners (n, 3, 3)`` [m]. A plain loop over triangles, each by its bounding
    rectangle: about 15 us a triangle and 10 ns a pixel.
    """
    depth = np.full((view.height_px, view.width_px), np.inf)
    nearest = np.full(depth.shape, -1, np.int32)
    points = view.project(corners)
    limit = np.array([view.width_px, view.height_px])
    low = np.clip(np.ceil(points[:, :, :2].min(axis=1) - 0.5), 0, limit).astype(int)
    high = np.clip(np.floor(points[:, :, :2].max(axis=1) - 0.5) + 1, 0, limit).astype(int)
    a, b, c = points[:, 0], points[:, 1], points[:, 2]
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    for i in np.flatnonzero((high > low).all(axis=1) & (area != 0.0)).tolist():
        x = np.arange(low[i, 0], high[i, 0]) + 0.5 - a[i, 0]
        y = np.arange(low[i, 1], high[i, 1])[:, None] + 0.5 - a[i, 1]
        s = (x * ac[i, 1] - y * ac[i, 0]) / area[i]
        t = (y * ab[i, 0] - x * ab[i, 1]) / area[i]
        z = a[i, 2] + s * ab[i, 2] + t * ac[i, 2]
        here = (slice(low[i, 1], high[i, 1]), slice(low[i, 0], high[i, 0]))
        drawn = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (z < depth[here])
        depth[here][drawn] = z[drawn]
        nearest[here][drawn] = i
    return depth, nearest


def sunlit_pixels(
    view: View, depth: np.ndarray, sun: View, corners: np.ndarray, bias_m: float
) -> np.ndarray:
    """Return which pixels the sun sees, by a depth buffer drawn from the sun."""
    from_sun, _ = draw_depth(sun, corners)
    y, x = np.nonzero(np.isfinite(depth))
    pixels = np.stack([x + 0.5, y + 0.5, depth[y, x]], axis=1)
    affine = view.image_from_cache
    back = np.linalg.inv(affine[:, :3])
    seen = sun.project((pixels - affine[:, 3]) @ back.T)
    column = np.clip(seen[:, 0].astype(int), 0, sun.width_px - 1)
    row = np.clip(seen[:, 1].astype(int), 0, sun.height_px - 1)
    lit = np.zeros(depth.shape, bool)
    lit[y, x] = seen[:, 2] <= from_sun[row, column] + bias_m
    return lit


def unit_normals(corners: np.ndarray) -> np.ndarray:
    """Return the normals of triangles ``(n, 3, 3)``; zero where there is no area."""
    corners = corners.astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)


def shade(
    view: View,
    sun: View,
    corners: np.ndarray,
    s: np.ndarray,
    light: np.ndarray,
    is_ground: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the picture ``(height, width, 3) uint8`` without lines, and its depth.

    A face turned to the light is as bright as it is steep to it; whatever is turned
    away or hidden from the light is in shade. Both sides of a face are the same.
    """
    depth, nearest = draw_depth(view, corners)
    lit = sunlit_pixels(view, depth, sun, corners, bias_m=0.12)
    normal = unit_normals(corners)
    back = -view.image_from_cache[2, :3]
    # The side that is seen: its normal looks to the eye.
    seen = normal * np.where(normal @ back < 0.0, -1.0, 1.0)[:, None]
    steep = seen @ light[:3]
    faces_light = (steep > 0.0) & (s != 0)
    bright = 0.62 + 0.38 * np.clip(steep, 0.0, 1.0)
    # In shade walls still differ a little by where they look.
    dim = 0.86 + 0.07 * seen[:, 2] + 0.07 * seen[:, 0]
    tint = np.where(is_ground[:, None], GROUND_TINT, 1.0)
    of_face = np.stack([SHADE * dim[:, None] * tint, SUNLIT * bright[:, None] * tint])
    in_sun = (lit & faces_light[nearest]).astype(int)
    picture = of_face[in_sun, nearest]
    picture[nearest < 0] = SKY
    return np.clip(picture, 0, 255).astype(np.uint8), depth


def visible_runs(
    view: View, depth: np.ndarray, begin: np.ndarray, end: np.ndarray, bias_m: float
) -> list[tuple[float, float, float, float]]:
    """Return the parts of lines ``(n, 3)`` to ``(n, 3)`` [m] that nothing hides, in pixels.

    A line is looked at every other pixel, and hidden where it lies behind all of
    the nine pixels around.
    """
    farthest = maximum_filter(depth, 3, mode="nearest")
    runs = []
    for a, b in zip(view.project(begin), view.project(end), strict=True):
        n = max(2, int(np.hypot(*(b - a)[:2]) / 2) + 1)
        x, y, z = (np.linspace(a[i], b[i], n) for i in range(3))
        inside = (x >= 0) & (x < view.width_px) & (y >= 0) & (y < view.height_px)
        column, row = (np.where(inside, v, 0).astype(int) for v in (x, y))
        is_seen = inside & (z <= farthest[row, column] + bias_m)
        change = np.flatnonzero(np.diff(np.concatenate(([False], is_seen, [False]))))
        for first, last in change.reshape(-1, 2) - [0, 1]:
            runs.append((x[first], y[first], x[last], y[last]))
    return runs


def draw(
    cache: Cache, light: Light, view: View, target: np.ndarray, around_m: float
) -> Image.Image:
    """Return the picture of `view`; shadows are right within `around_m` of `target`."""
    mesh = cache.mesh
    towards_light = light.in_cache_frame(cache.grid)
    is_ground = np.array([name.startswith("terrain") for name in cache.object_names])
    # The rim of each terrain tile is silhouette, too; it would only rule the ground.
    found = silhouette(cache, towards_light, objects=np.flatnonzero(~is_ground))
    sun = parallel_view(towards_light[:3], target, 2 * around_m, (SHADOW_MAP_PX, SHADOW_MAP_PX))
    corners = mesh.positions[mesh.faces].astype(np.float64)
    s = facing(cache.planes.planes, towards_light)[cache.planes.plane_of_face]
    on_ground = np.repeat(is_ground, np.diff(mesh.object_face_start))
    pixels, depth = shade(view, sun, corners, s, towards_light, on_ground)
    image = Image.fromarray(pixels)
    canvas = ImageDraw.Draw(image)
    ends = mesh.positions[cache.edges.rows[found.edge, :2]]
    for run in visible_runs(view, depth, ends[:, 0], ends[:, 1], bias_m=0.1):
        canvas.line(run, fill=LINE, width=round(DRAWN_LINE_PX * SUPERSAMPLING))
    return image.resize(
        (view.width_px // SUPERSAMPLING, view.height_px // SUPERSAMPLING),
        Image.Resampling.LANCZOS,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(description="Draw the silhouette that the sun sees.")
    parser.add_argument("cache", nargs="?", help="default: the sample city, built for this")
    parser.add_argument(
        "--light", default="dir:135,35", metavar="SPEC", help="dir:AZIMUTH,ALTITUDE"
    )
    parser.add_argument(
        "--eye", default="dir:215,35", metavar="SPEC", help="where it is seen from, as a light"
    )
    parser.add_argument(
        "--target", type=float, nargs=3, default=(58.0, 20.0, 11.0), metavar=("X", "Y", "Z"),
        help="the middle of the picture, input coordinates",
    )  # fmt: skip
    parser.add_argument("--width", type=float, default=236.0, metavar="M", help="of the picture")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 640), metavar=("W", "H"))
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "silhouette.png")
    args = parser.parse_args(argv)
    try:
        light, eye = parse_light(args.light), parse_light(args.eye)
        if light.w or eye.w:
            raise InputError("the light and the eye of this picture are directions: dir:...")
        with tempfile.TemporaryDirectory() as folder:
            if args.cache is None:
                args.cache = f"{folder}/city.svp.h5"
                svprep.build([SAMPLE], args.cache)
            with svprep.open_cache(args.cache) as cache:
                target = np.array(args.target) - cache.grid.origin_m
                size_px = (SUPERSAMPLING * args.size[0], SUPERSAMPLING * args.size[1])
                back = np.array([eye.x, eye.y, eye.z])
                view = parallel_view(back, target, args.width, size_px)
                image = draw(cache, light, view, target, args.width)
    except SvprepError as error:
        print(f"picture_silhouette: {error}", file=sys.stderr)
        return error.exit_status
    args.output.parent.mkdir(parents=True, exist_ok=True)
    # 128 colours are enough for flat faces, and a third of the bytes.
    image.quantize(128, dither=Image.Dither.NONE).save(args.output, optimize=True)
    print(f"{args.output}: {args.output.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

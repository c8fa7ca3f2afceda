"""Draw how long the sun shines on what is seen, as a picture: docs/hours.png.

    python scripts/picture_hours.py                       the sample city
    python scripts/picture_hours.py city.svp.h5 -o a.png --arc 'sun:48.2,16.37,...'

A ray through each pixel finds a point, and `svprep.hours.trace_points` its minutes. The
same cache gives the same picture.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

import svprep
from picture_silhouette import SAMPLE, SKY, View, parallel_view, unit_normals
from svprep.cache.reader import Cache
from svprep.errors import InputError, SvprepError
from svprep.hours import trace_points
from svprep.hours.ply_points import ramp
from svprep.light import Arc, parse_arc, parse_light
from svprep.rays import Scene

ROOT = Path(__file__).resolve().parents[1]
SUPERSAMPLING = 2
ONE_PLACE_M = 0.005
ARC = "sun:48.2,16.37,2026-03-20/06:00/18:30/15m[Europe/Vienna]"


def seen_points(cache: Cache, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels ``(n,)`` that show a face, the face and the point of each.

    Of faces in one place, the one that looks towards the eye is seen.
    """
    affine = view.image_from_cache
    back = np.linalg.inv(affine[:, :3])
    forward = back[:, 2]
    y, x = np.divmod(np.arange(view.width_px * view.height_px), view.width_px)
    reach = 2.0 * float(np.abs(cache.mesh.positions).max())
    at = np.stack([x + 0.5, y + 0.5, np.full(len(x), -reach)], axis=1)
    origins = (at - affine[:, 3]) @ back.T
    directions = np.broadcast_to(forward.astype(np.float32), origins.shape)
    positions, faces = cache.mesh.positions, cache.mesh.faces
    rays = origins.astype(np.float32), np.array(directions)
    face, distance_m = Scene(positions, faces).first_hit(*rays)
    towards_eye = np.flatnonzero(unit_normals(positions[faces]) @ forward < 0.0)
    front, front_m = Scene(positions, faces[towards_eye]).first_hit(*rays)
    is_front = (front >= 0) & (face >= 0) & (front_m <= distance_m + ONE_PLACE_M)
    face[is_front] = towards_eye[front[is_front]]
    pixel = np.flatnonzero(face >= 0)
    point = origins[pixel] + distance_m[pixel, None] * forward
    return pixel, face[pixel], point


def draw(cache: Cache, arc: Arc, view: View) -> Image.Image:
    """Return the picture of `view`: dark without sun, light with as much as the arc has."""
    pixel, face, point = seen_points(cache, view)
    hours = trace_points(cache, arc, point, face)
    of_steps = ramp(np.linspace(0.0, 1.0, len(arc.lights) + 1))
    picture = np.empty((view.width_px * view.height_px, 3), np.uint8)
    picture[:] = SKY
    # A little darker where a face looks away from the south-west, so that edges are seen.
    normal = unit_normals(cache.mesh.positions[cache.mesh.faces[face]])
    towards_eye = -np.linalg.inv(view.image_from_cache[:, :3])[:, 2]
    bright = 0.86 + 0.14 * np.abs(normal @ towards_eye) / np.linalg.norm(towards_eye)
    picture[pixel] = (of_steps[hours.total_steps] * bright[:, None]).astype(np.uint8)
    image = Image.fromarray(picture.reshape(view.height_px, view.width_px, 3))
    size = view.width_px // SUPERSAMPLING, view.height_px // SUPERSAMPLING
    return image.resize(size, Image.Resampling.LANCZOS)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = argparse.ArgumentParser(description="Draw how long the sun shines on what is seen.")
    parser.add_argument("cache", nargs="?", help="default: the sample city, built for this")
    parser.add_argument("--arc", default=ARC, metavar="SPEC", help="of the sun")
    parser.add_argument(
        "--eye", default="dir:325,40", metavar="SPEC", help="where it is seen from, as a light"
    )
    parser.add_argument(
        "--target", type=float, nargs=3, default=(58.0, 20.0, 11.0), metavar=("X", "Y", "Z"),
        help="the middle of the picture, input coordinates",
    )  # fmt: skip
    parser.add_argument("--width", type=float, default=236.0, metavar="M", help="of the picture")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 640), metavar=("W", "H"))
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "hours.png")
    args = parser.parse_args(argv)
    try:
        eye = parse_light(args.eye)
        if eye.w:
            raise InputError("the eye of this picture is a direction: dir:...")
        with tempfile.TemporaryDirectory() as folder:
            if args.cache is None:
                args.cache = f"{folder}/city.svp.h5"
                svprep.build([SAMPLE], args.cache)
            with svprep.open_cache(args.cache) as cache:
                target = np.array(args.target) - cache.grid.origin_m
                size_px = (SUPERSAMPLING * args.size[0], SUPERSAMPLING * args.size[1])
                back = np.array([eye.x, eye.y, eye.z])
                view = parallel_view(back, target, args.width, size_px)
                image = draw(cache, parse_arc(args.arc), view)
    except SvprepError as error:
        print(f"picture_hours: {error}", file=sys.stderr)
        return error.exit_status
    args.output.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(192, dither=Image.Dither.NONE).save(args.output, optimize=True)
    print(f"{args.output}: {args.output.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())

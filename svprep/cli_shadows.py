"""What ``svprep validate --shadows`` does: draw a view, judge it by rays, say what differs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from svprep.cache.reader import Cache, open_cache
from svprep.cli_render import IMAGE, ViewOptions, png, request_of, require_pillow
from svprep.errors import require_extra
from svprep.light import Light
from svprep.output_file import write_whole

if TYPE_CHECKING:
    from svprep_runtime.judge_report import Comparison, Truth

_LEAST_SHARE: Final = 0.6
_MOST_LISTED: Final = 12
"""Pixels and overlaps that are listed for people; --json lists all."""


def judge(
    path: Path,
    view: ViewOptions,
    difference: str | None,
    tell: Callable[[str, int, int], None],
) -> dict[str, Any]:
    """Draw a view of a cache, judge each light by rays, and return what ``--json`` prints.

    `difference` names the picture of what differs (of several lights, the last that does).

    Raises
    ------
    InputError, CacheError, EnvironmentProblem
        As `svprep_runtime.drawing.draw_cache` and `svprep_runtime.judge.Judge` say.
    """
    import numpy as np

    from svprep_runtime.drawing import camera_text, draw_cache

    try:
        from svprep_runtime.judge import JUDGE_CONSTANTS, Judge, compare, difference_picture
        from svprep_runtime.judge_causes import causes_of
    except ImportError as error:
        raise require_extra(error.name or "embreex", "judge", "validate --shadows") from None

    if difference is not None:
        require_pillow()
        IMAGE.checked_path(difference, [path])
    begun = time.perf_counter()
    with open_cache(path) as cache:
        request = request_of(cache, view, with_figures=False)
        tell("drawing", 0, 1 + len(request.lights))
        rays = Judge(cache.mesh, cache.planes, cache.object_names)
        drawn = draw_cache(cache, request)
        judged = []
        for i, light in enumerate(request.lights):
            tell(f"judging light {i + 1} of {len(request.lights)}", 1 + i, 1 + len(request.lights))
            vector = light.in_cache_frame(cache.grid)
            truth = rays.truth(drawn.camera, vector)
            mask = np.where(drawn.picture.in_shadow[i], 255, 0).astype(np.uint8)
            compared = compare(truth, mask, drawn.picture.is_surface)
            causes = causes_of(
                cache.mesh, cache.planes, drawn.camera, vector, truth, mask, compared.differing
            )
            if difference is not None and (compared.n_differing or i == 0):
                picture = difference_picture(truth, mask)
                write_whole(IMAGE.checked_path(difference, [path]), [png(picture)])
            n_negative = drawn.picture.tallies[i].n_negative
            judged.append(_light(cache, light, truth, compared, causes, n_negative))
        return {
            "cache": str(path),
            "size": [view.width_px, view.height_px],
            "camera": camera_text(drawn.camera, cache.grid),
            "renderer": drawn.context.renderer,
            "method": view.settings.method,
            "constants": JUDGE_CONSTANTS,
            "lights": judged,
            "difference": difference,
            "seconds": round(time.perf_counter() - begun, 3),
        }


def _light(
    cache: Cache,
    light: Light,
    truth: Truth,
    compared: Comparison,
    causes: Sequence[str],
    n_negative: int,
) -> dict[str, Any]:
    """Return what is said of one light; `causes` are of the first pixels that differ."""
    pixels = zip_longest(compared.differing.tolist(), causes)
    return {
        "spec": light.spec,
        "words": light.words,
        "surface_pixels": compared.n_surface,
        "decidable_pixels": compared.n_decidable,
        "decidable_share": round(compared.decidable_share, 6),
        "differing_pixels": compared.n_differing,
        "differing": [
            _pixel(cache, truth, *place) | {"cause": cause or ""} for place, cause in pixels
        ],
        "shadow_in_sky": compared.n_shadow_in_sky,
        "negative_counts": n_negative,
        "overlaps": [{"objects": list(o.names), "pixels": o.pixels} for o in truth.overlaps],
    }


def _pixel(cache: Cache, truth: Truth, row: int, column: int) -> dict[str, Any]:
    """Return where a differing pixel is, and which object it shows."""
    import numpy as np

    face = int(truth.face[row, column])
    owner = int(np.searchsorted(cache.mesh.object_face_start, face, "right")) - 1
    return {
        "row": row,
        "column": column,
        "object": cache.object_names[owner] if face >= 0 else None,
        "by_rays": "shadow" if truth.in_shadow[row, column] else "lit",
    }


def is_clean(summary: dict[str, Any]) -> bool:
    """Return whether pixels could be judged, none of them differs, and no sky shows a surface."""
    return all(
        x["decidable_pixels"] and not x["differing_pixels"] and not x["shadow_in_sky"]
        for x in summary["lights"]
    )


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as lines for people."""
    width, height = summary["size"]
    lines = [
        f"picture  {width} x {height}; {summary['method']}, {summary['renderer']}",
        f"camera   --camera {summary['camera']}",
        f"judge    {summary['constants']}",
    ]
    for light in summary["lights"]:
        lines.append(
            f"light    {light['words']}: {light['surface_pixels']:,} surface pixels, "
            f"{light['decidable_pixels']:,} decidable ({light['decidable_share']:.1%}), "
            f"{light['differing_pixels']:,} of them differ"
        )
        for pixel in light["differing"][:_MOST_LISTED]:
            lines.append(
                f"differs  row {pixel['row']}, column {pixel['column']}: "
                f"{pixel['object']}, {pixel['by_rays']} by rays, drawn otherwise"
            )
            lines.append(f"why      {pixel['cause']}")
        if len(light["differing"]) > _MOST_LISTED:
            lines.append(f"differs  ... and {len(light['differing']) - _MOST_LISTED} more (--json)")
        if light["shadow_in_sky"]:
            lines.append(f"differs  pixels of sky that show a surface: {light['shadow_in_sky']}")
        if not light["decidable_pixels"]:
            lines.append("differs  nothing to judge: no pixel is decidable; choose another camera")
        elif light["decidable_share"] < _LEAST_SHARE:
            lines.append(
                f"warning  below {_LEAST_SHARE:.0%} decidable, this view says little: choose a "
                "nearer camera or a larger --size"
            )
        if light["negative_counts"]:
            lines.append(
                f"note     pixels whose count fell below 0, drawn as lit: "
                f"{light['negative_counts']}"
            )
        for overlap in light["overlaps"][:_MOST_LISTED]:
            first, second = overlap["objects"]
            lines.append(f"overlap  {first} and {second} coincide on {overlap['pixels']:,} pixels")
        if len(light["overlaps"]) > _MOST_LISTED:
            lines.append(f"overlap  ... and {len(light['overlaps']) - _MOST_LISTED} more (--json)")
    if summary["difference"]:
        lines.append(f"image    {summary['difference']}")
    lines.append(f"seconds  {summary['seconds']:.2f}")
    lines.append(
        "valid"
        if is_clean(summary)
        else "not valid: pixels differ from rays, or none could be judged"
    )
    return lines

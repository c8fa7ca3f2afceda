"""What ``svprep render`` does with its options: draw, write, sum up, say it."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import typer

from svprep.cache.reader import Cache, open_cache
from svprep.cli_options import memory_of
from svprep.errors import require_extra
from svprep.light import Light, is_arc, is_sun, parse_light
from svprep.output_file import OutputKind, write_whole

if TYPE_CHECKING:
    import numpy as np

    from svprep_runtime.drawing import Drawn
    from svprep_runtime.frame import Settings

DEFAULT_LIGHT: Final = "dir:135,40"
DEFAULT_SIZE: Final = "1280x1024"
METHODS: Final = ("auto", "zpass", "zfail", "zp+")
CLAMPS: Final = ("auto", "none")
COUNTERS: Final = ("float", "stencil")
CONSTRUCTIONS: Final = ("vertex", "geometry")
_SIZE: Final = re.compile(r"([0-9]{1,6})[xX]([0-9]{1,6})")
_TITLE: Final = "svprep"
_Name = TypeVar("_Name", bound=str)


def _is_ours(head: bytes) -> bool:
    """Whether a PNG begins as one that `png` made."""
    return head.startswith(b"\x89PNG") and b"tEXtSoftware\0svprep" in head


IMAGE: Final = OutputKind(
    name="the picture",
    form="pictures are written as .png",
    what="is not a picture of svprep",
    suffixes=(".png",),
    is_ours=_is_ours,
)
MASK: Final = OutputKind(
    name="the mask",
    form="masks are written as .png",
    what="is not a picture of svprep",
    suffixes=(".png",),
    is_ours=_is_ours,
    option="--mask",
)


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """What `render` and ``validate --shadows`` are both told."""

    light_specs: tuple[str, ...]
    camera: str | None
    width_px: int
    height_px: int
    settings: Settings
    budget_bytes: int | None
    """None: as much as usual."""


@dataclass(frozen=True, slots=True)
class Query:
    """The options of one call of `render`, each already known to be of its kind."""

    cache: Path
    view: ViewOptions
    output: str
    mask: str | None


def view_options(
    lights: Sequence[str],
    camera: str | None,
    size: str,
    method: str,
    clamp: str,
    *,
    counter: str = "float",
    construction: str = "vertex",
    samples: int = 1,
    memory: str | None = None,
) -> ViewOptions:
    """Return the options of a view.

    Raises
    ------
    typer.BadParameter
        One is not of its kind.
    InputError
        A light is none. The sun is looked at later: it may need the cache's CRS.
    EnvironmentProblem
        A package for drawing is missing.
    """
    width_px, height_px = size_of(size)
    known = (
        one_of("--method", method, METHODS),
        one_of("--clamp", clamp, CLAMPS),
        one_of("--counter", counter, COUNTERS),
        one_of("--construction", construction, CONSTRUCTIONS),
    )
    if samples < 1 or samples % 2 == 0:
        raise typer.BadParameter(f"--samples {samples}: an odd number, so that most of them agree")
    specs = tuple(lights) or (DEFAULT_LIGHT,)
    for spec in specs:
        if is_arc(spec):
            raise typer.BadParameter(
                f'a picture is of moments, and "{spec}" is an arc of the sun; one moment of '
                "it is written sun:LAT,LON,2026-03-20T12:00[Europe/Vienna]"
            )
        if not is_sun(spec):
            parse_light(spec)
    return ViewOptions(
        light_specs=specs,
        camera=camera,
        width_px=width_px,
        height_px=height_px,
        settings=_settings(*known, samples=samples),
        budget_bytes=None if memory is None else memory_of(memory),
    )


def _settings(
    method: str, clamp: str, counter: str, construction: str, *, samples: int
) -> Settings:
    try:
        from svprep_runtime.frame import Settings
    except ImportError as error:
        raise require_extra(error.name or "moderngl", "view", "drawing") from None
    return Settings(
        method=method,  # type: ignore[arg-type]
        clamp=clamp == "auto",
        counter=counter,  # type: ignore[arg-type]
        construction=construction,  # type: ignore[arg-type]
        samples=samples,
    )


def one_of(option: str, given: str, known: Sequence[_Name]) -> _Name:
    """Return the one of `known` that is `given`.

    Raises
    ------
    typer.BadParameter
        It is none.
    """
    for name in known:
        if name == given:
            return name
    raise typer.BadParameter(f'{option} "{given}" is none of {", ".join(known)}')


def size_of(text: str) -> tuple[int, int]:
    """Return width and height of ``WxH`` [pixels].

    Raises
    ------
    typer.BadParameter
        It is not of that form, or a side is 0.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None or not int(match[1]) or not int(match[2]):
        raise typer.BadParameter(f'--size "{text}" is not WIDTHxHEIGHT in pixels, like 1280x1024')
    return int(match[1]), int(match[2])


def lights_of(cache: Cache, view: ViewOptions) -> tuple[Light, ...]:
    """Return the lights of a view; suns stand where the cache says."""
    return tuple(parse_light(spec, cache.site) for spec in view.light_specs)


def request_of(cache: Cache, view: ViewOptions, *, with_figures: bool) -> Any:
    """Return the `svprep_runtime.drawing.Request` of a view."""
    from svprep_runtime.drawing import Request
    from svprep_runtime.residency import DEFAULT_BUDGET_BYTES

    return Request(
        lights=lights_of(cache, view),
        camera=view.camera,
        width_px=view.width_px,
        height_px=view.height_px,
        settings=view.settings,
        budget_bytes=DEFAULT_BUDGET_BYTES if view.budget_bytes is None else view.budget_bytes,
        with_figures=with_figures,
    )


def query_of(cache: Path, view: ViewOptions, output: str | None, mask: str | None) -> Query:
    """Return the options as a query, its output files known to be writable.

    Raises
    ------
    InputError, EnvironmentProblem
        As `OutputKind.checked_path`.
    """
    name = cache.name.removesuffix(".h5").removesuffix(".svp")
    require_pillow()
    chosen = output if output is not None else f"{name}.png"
    IMAGE.checked_path(chosen, [cache])
    if mask is not None:
        MASK.checked_path(mask, [cache, chosen])
    return Query(cache, view, chosen, mask)


def answer(query: Query, *, with_figures: bool) -> dict[str, Any]:
    """Draw, write the files, and return what ``--json`` prints.

    Raises
    ------
    InputError, CacheError, EnvironmentProblem
        As `svprep_runtime.drawing.draw_cache` says; the disk is full.
    """
    import numpy as np

    from svprep_runtime.drawing import camera_text, draw_cache
    from svprep_runtime.frame import to_srgb

    with open_cache(query.cache) as cache:
        request = request_of(cache, query.view, with_figures=with_figures)
        drawn = draw_cache(cache, request)
        camera = camera_text(drawn.camera, cache.grid)
    picture = drawn.picture
    target = IMAGE.checked_path(query.output, [query.cache])
    write_whole(target, [png(to_srgb(picture.radiance))])
    if query.mask is not None:
        write_whole(MASK.checked_path(query.mask, [query.cache]), [png(picture.mask)])
    n_pixels = query.view.width_px * query.view.height_px
    n_surface = int(np.count_nonzero(picture.is_surface))
    return {
        "cache": str(query.cache),
        "image": query.output,
        "mask": query.mask,
        "size": [query.view.width_px, query.view.height_px],
        "camera": camera,
        "renderer": drawn.context.renderer,
        "opengl": drawn.context.version,
        "method": query.view.settings.method,
        "counter": query.view.settings.counter,
        "construction": query.view.settings.construction,
        "samples": query.view.settings.samples,
        "surface_pixels": n_surface,
        "surface_share": round(n_surface / n_pixels, 6),
        "buffer_bytes": drawn.used_bytes,
        "lights": _light_facts(request.lights, drawn, n_surface),
        "passes": [
            {
                "name": f.name,
                "light": f.light,
                "ms": round(f.ms, 3),
                "wall_ms": round(f.wall_ms, 3),
                "primitives": f.n_primitives,
                "samples": f.n_samples,
            }
            for f in picture.figures
        ],
        "seconds": {name: round(s, 4) for name, s in drawn.seconds.items()},
    }


def _light_facts(lights: Sequence[Light], drawn: Drawn, n_surface: int) -> list[dict[str, Any]]:
    facts = []
    for light, in_shadow, tally in zip(
        lights, drawn.picture.in_shadow, drawn.picture.tallies, strict=True
    ):
        n = int(in_shadow.sum())
        facts.append(
            {
                "spec": light.spec,
                "words": light.words,
                "shadow_pixels": n,
                "shadow_share": round(n / n_surface, 6) if n_surface else None,
                "clamped_segments": tally.n_clamped_segments,
                "highest_count": tally.highest_count,
                "negative_counts": tally.n_negative,
            }
        )
    return facts


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as lines for people."""
    width, height = summary["size"]
    lines = [
        f"picture  {width} x {height}, {summary['surface_share']:.1%} of it surface; "
        f"{summary['method']}, {summary['renderer']}"
    ]
    for light in summary["lights"]:
        share = (
            "nothing in view"
            if light["shadow_share"] is None
            else (f"{light['shadow_share']:.1%} of what is seen is in its shadow")
        )
        clamped = (
            f"{light['clamped_segments']:,} clamped segments"
            if light["clamped_segments"]
            else "not clamped"
        )
        lines.append(f"light    {light['words']}: {share}; {clamped}")
        if light["negative_counts"]:
            lines.append(
                f"note     pixels whose count fell below 0, where slivers meet within a "
                f"rasteriser's grid; drawn as lit: {light['negative_counts']}"
            )
    if not summary["surface_pixels"]:
        lines.append(
            "warning  nothing of the model is in view; without --camera all of it is shown"
        )
    lines.append(f"camera   --camera {summary['camera']}")
    for each in summary["passes"]:
        lines.append(
            f"pass     {each['name']}: {each['wall_ms']:.1f} ms, {each['primitives']:,} triangles, "
            f"{each['samples']:,} samples"
        )
    seconds = ", ".join(f"{name} {s:.2f}" for name, s in summary["seconds"].items())
    lines.append(f"seconds  {sum(summary['seconds'].values()):.2f} ({seconds})")
    lines.append(f"image    {summary['image']}")
    if summary["mask"]:
        lines.append(f"mask     {summary['mask']}")
    return lines


def require_pillow() -> None:
    """Raise `EnvironmentProblem` unless pictures can be written: before the work, not after."""
    try:
        import PIL.Image  # noqa: F401
    except ImportError:
        raise require_extra("Pillow", "view", "writing pictures") from None


def png(pixels: np.ndarray) -> bytes:
    """Return a PNG of ``(height, width)`` or ``(height, width, 3)`` uint8 pixels."""
    from PIL import Image, PngImagePlugin

    told = PngImagePlugin.PngInfo()
    told.add_text("Software", _TITLE)
    into = io.BytesIO()
    Image.fromarray(pixels).save(into, "PNG", pnginfo=told)
    return into.getvalue()

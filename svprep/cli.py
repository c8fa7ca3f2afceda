"""The command line: options in, one line per outcome out, exit status told.

Heavy modules are imported inside the commands that need them, so that
``svprep --help`` does not even load NumPy. Results go to standard output,
messages and progress to standard error; ``--json`` prints one object.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import sys
import tempfile
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from svprep import __version__
from svprep.errors import SvprepError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from svprep.cache.reader import Cache
    from svprep.model import Prepared
    from svprep.pipeline import BuildResult

_UsageError: type[Exception] = typer.BadParameter.__mro__[2]
"""Click's base exception, whether Typer brings Click along or depends on it."""

app = typer.Typer(
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Prepare city meshes for exact shadow volumes, and check what was prepared.",
)

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output.")
]


LIGHT_HELP = (
    "dir:AZIMUTH,ALTITUDE in degrees, clockwise from north and above the horizon; point:X,Y,Z in "
    "input coordinates; sun:LAT,LON,2026-06-21T12:00+02:00"
)
LightsOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SPEC",
        help=f"Clamp the shadows of a light: {LIGHT_HELP}; or an arc, a light per step by day: "
        "sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]. May be repeated.",
    ),
]
CostVertexOption = Annotated[
    float | None,
    typer.Option(
        metavar="X",
        help="What drawing a vertex costs, for clamping: a gap is left where that of two more "
        "caps is less than that of the sides across it (V < R). Default 4.",
    ),
]
CostAreaOption = Annotated[
    float | None,
    typer.Option(
        metavar="X", help="What drawing a square metre of side or cap costs. Default 1; 0: no gaps."
    ),
]


CameraOption = Annotated[
    str | None,
    typer.Option(
        metavar="C",
        help="EX,EY,EZ,TX,TY,TZ[,FOV]: eye and target in input coordinates, vertical degrees. "
        "Default: all of the model, from the south-west.",
    ),
]
ViewLightsOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SPEC", help=f"{LIGHT_HELP}. May be repeated. Default: azimuth 135, altitude 40."
    ),
]
_PICTURE_SIZE = "1280x1024"
SizeOption = Annotated[str, typer.Option(metavar="WxH", help="Pixels.")]
MethodOption = Annotated[
    str,
    typer.Option(
        metavar="M", help="How to count: auto, zpass, zfail or zp+. Shadows are the same."
    ),
]
ClampOption = Annotated[
    str,
    typer.Option(
        metavar="K", help="auto: clamped volumes for lights that the cache holds; none: whole ones."
    ),
]
CounterOption = Annotated[
    str,
    typer.Option(
        metavar="T", help="float: exact to millions of layers; stencil: 8 bits, modulo 256."
    ),
]
ConstructionOption = Annotated[
    str,
    typer.Option(
        metavar="S", help="vertex: sides from silhouette edges; geometry: by a geometry shader."
    ),
]
SamplesOption = Annotated[
    int,
    typer.Option(metavar="N", help="Samples of a pixel, odd; the shadow is what most say."),
]
MemoryOption = Annotated[
    str | None,
    typer.Option(metavar="SIZE", help="Graphics memory for buffers, such as 512M. Default 4G."),
]


@app.callback(invoke_without_command=True)
def root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Handle what stands before a command."""
    if version:
        print(f"svprep {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def build(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT...", help="Model files: .obj .ply .stl .off .glb .gltf, or .gz of one."
        ),
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "-o", "--output", metavar="CACHE", help="Default: STEM.svp.h5 in the current folder."
        ),
    ] = None,
    weld_tolerance: Annotated[
        float,
        typer.Option(metavar="M", help="Pull vertices of an object within M metres together."),
    ] = 0.0,
    light: LightsOption = None,
    cost_vertex: CostVertexOption = None,
    cost_area: CostAreaOption = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write what was found and done per object (.json or .csv)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Read model files, repair them and write the cache."""
    from svprep import cli_clamp, pipeline
    from svprep.report import REPORT, write_report
    from svprep.warm import second_compiler

    if not 0.0 <= weld_tolerance < float("inf"):
        raise typer.BadParameter("--weld-tolerance is a distance in metres, 0 or more")
    if report is not None:
        if not REPORT.has_suffix(report):
            raise typer.BadParameter(f"{report}: a report is .json or .csv; name it so")
        REPORT.checked_path(report, [*inputs, output or pipeline.default_cache_path(inputs)])
    config = pipeline.BuildConfig(weld_tolerance_m=weld_tolerance)
    costs = cli_clamp.costs_of(cost_vertex, cost_area)
    with _progress() as tell, second_compiler():
        result = pipeline.build(
            inputs,
            output,
            config,
            lambda stage: tell(stage, pipeline.STAGES.index(stage), len(pipeline.STAGES)),
            lights=light or [],
            costs=costs,
        )
    if report is not None:
        write_report(result.prepared, report)
    summary = _build_summary(result)
    if as_json:
        print(json.dumps(summary))
        return
    _print_build(summary)
    if report is not None:
        print(f"report   {report}")


@app.command()
def info(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")], as_json: JsonOption = False
) -> None:
    """Say what a cache holds: contents, sizes, defects found and repaired."""
    from svprep.cache.reader import open_cache

    with open_cache(_cache_not_model(cache)) as opened:
        summary = _cache_summary(opened)
    if as_json:
        print(json.dumps(summary))
    else:
        _print_info(summary)


@app.command()
def validate(
    cache: Annotated[Path | None, typer.Argument(metavar="CACHE")] = None,
    deep: Annotated[
        bool,
        typer.Option(
            "--deep",
            help="Recompute multiplicities for 100 lights, ask manifold3d, repair again.",
        ),
    ] = False,
    shadows: Annotated[
        bool,
        typer.Option(
            "--shadows",
            help="Draw a view and have rays judge every pixel; takes the options of render.",
        ),
    ] = False,
    light: ViewLightsOption = None,
    camera: CameraOption = None,
    size: SizeOption = _PICTURE_SIZE,
    method: MethodOption = "auto",
    clamp: ClampOption = "auto",
    counter: CounterOption = "float",
    construction: ConstructionOption = "vertex",
    samples: SamplesOption = 1,
    memory: MemoryOption = None,
    difference: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="With --shadows: a .png of the pixels that differ."),
    ] = None,
    explain: Annotated[
        str | None,
        typer.Option(metavar="CODE", help="Document a defect or problem code, such as D302."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check that a cache is right; exit status 1 if it is not."""
    from svprep import validate as checks

    if explain is not None:
        text = checks.explain(explain)
        print(json.dumps({"code": explain, "text": text}) if as_json else text)
        return
    if cache is None:
        raise typer.BadParameter("name the cache to check, or a code: --explain CODE")
    if shadows:
        if deep:
            raise typer.BadParameter("--deep and --shadows are two checks; ask for one at a time")
        from svprep import cli_render, cli_shadows

        view_options = cli_render.view_options(
            light or [],
            camera,
            size,
            method,
            clamp,
            counter=counter,
            construction=construction,
            samples=samples,
            memory=memory,
        )
        with _progress() as tell:
            judged = cli_shadows.judge(_cache_not_model(cache), view_options, difference, tell)
        _say_default_light(light)
        _show(judged, cli_shadows.summary_lines(judged), as_json=as_json)
        if not cli_shadows.is_clean(judged):
            raise typer.Exit(1)
        return
    usual = (None, None, _PICTURE_SIZE, "auto", "auto", "float", "vertex", 1, None, None)
    given = (light or None, camera, size, method, clamp, counter, construction, samples, memory)
    if (*given, difference) != usual:
        raise typer.BadParameter("the options of a view (--light, --camera, ...) need --shadows")
    with _progress() as tell:
        outcome = checks.validate(_cache_not_model(cache), deep=deep, on_step=tell)
    if as_json:
        print(
            json.dumps(
                {
                    "cache": outcome.path,
                    "valid": outcome.is_valid,
                    "deep": outcome.is_deep,
                    "checks": list(outcome.checks),
                    "problems": [
                        {"code": p.code, "where": p.where, "message": p.message}
                        for p in outcome.problems
                    ],
                }
            )
        )
    else:
        for line in outcome.checks:
            print(f"checked  {line}")
        for line in checks.problem_lines(outcome):
            print(f"failed   {line}")
        n = len(outcome.problems)
        print("valid" if n == 0 else f"not valid: {n} problem{'' if n == 1 else 's'}")
    if not outcome.is_valid:
        raise typer.Exit(1)


@app.command()
def silhouette(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SPEC",
            help=f"{LIGHT_HELP}. Needed, once.",
        ),
    ] = None,
    method: Annotated[
        str,
        typer.Option(
            metavar="M",
            help="How to search: auto, brute, edge_buffer, elimination, flat, cones or hextree. "
            "The result is the same.",
        ),
    ] = "auto",
    volume: Annotated[
        str,
        typer.Option(
            metavar="V",
            help="auto (closed where that is right), or closed or robust everywhere, for study: "
            "closed is wrong for open surfaces.",
        ),
    ] = "auto",
    objects: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only objects of exactly this name; may be repeated."),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write lines: .ply, .obj or .npz."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find the edges at which the shadow volumes of one light begin."""
    from svprep import cli_silhouette

    query = cli_silhouette.query_of(cache, light or [], method, volume, objects or [], output)
    _cache_not_model(cache)
    summary = cli_silhouette.answer(query)
    _show(summary, cli_silhouette.summary_lines(summary), as_json=as_json)


@app.command()
def clamp(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: LightsOption = None,
    cost_vertex: CostVertexOption = None,
    cost_area: CostAreaOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add lights to a cache: where the shadow of each part can be received."""
    from svprep import cli_clamp

    costs = cli_clamp.costs_of(cost_vertex, cost_area)
    with _progress() as tell:
        summary = cli_clamp.add(_cache_not_model(cache), light or [], costs, tell)
    _show(summary, cli_clamp.add_lines(summary), as_json=as_json)


@app.command()
def hours(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ARC",
            help="The sun over a part of a day: "
            "sun:LAT,LON,2026-03-20/06:00/18:00/15m[Europe/Vienna]. Needed, once.",
        ),
    ] = None,
    spacing: Annotated[
        float,
        typer.Option(metavar="M", help="One sample per M x M metres of surface."),
    ] = 1.0,
    output: Annotated[
        list[str] | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write a table of objects (.csv) or all samples as points (.ply); may be "
            "repeated.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Count how long the sun shines on roofs, walls and ground."""
    from svprep import cli_hours

    query = cli_hours.query_of(cache, light or [], spacing, output or [])
    _cache_not_model(cache)
    with _progress() as tell:
        summary = cli_hours.answer(query, tell)
    _show(summary, cli_hours.summary_lines(summary), as_json=as_json)


@app.command()
def render(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: ViewLightsOption = None,
    camera: CameraOption = None,
    size: SizeOption = _PICTURE_SIZE,
    method: MethodOption = "auto",
    clamp: ClampOption = "auto",
    counter: CounterOption = "float",
    construction: ConstructionOption = "vertex",
    samples: SamplesOption = 1,
    memory: MemoryOption = None,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="IMAGE", help="A .png. Default: STEM.png here."),
    ] = None,
    mask: Annotated[
        str | None,
        typer.Option(
            metavar="MASK",
            help="A .png: 255 where a surface is in shadow (of several lights: of all), else 0.",
        ),
    ] = None,
    stats: Annotated[
        bool, typer.Option("--stats", help="Say what each pass took; --json always does.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Draw a picture with exact shadows, without a window."""
    from svprep import cli_render

    view_options = cli_render.view_options(
        light or [],
        camera,
        size,
        method,
        clamp,
        counter=counter,
        construction=construction,
        samples=samples,
        memory=memory,
    )
    query = cli_render.query_of(_cache_not_model(cache), view_options, output, mask)
    summary = cli_render.answer(query, with_figures=stats or as_json)
    _say_default_light(light)
    _show(summary, cli_render.summary_lines(summary), as_json=as_json)


@app.command()
def view(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SPEC",
            help=f"{LIGHT_HELP}; or an arc. May be repeated. Default: azimuth 135, altitude 40.",
        ),
    ] = None,
    camera: CameraOption = None,
    size: SizeOption = "1280x800",
    method: MethodOption = "auto",
    clamp: ClampOption = "auto",
) -> None:
    """Look around in a window, and drag the sun; F1 there lists the keys."""
    from svprep import cli_view

    cli_view.view(
        _cache_not_model(cache),
        light or [],
        size,
        camera,
        method,
        clamp,
        lambda line: print(f"svprep: {line}", file=sys.stderr),
    )


@app.command()
def doctor(as_json: JsonOption = False) -> None:
    """Say what this machine has of what svprep needs; exit status 1 if something is bad."""
    from svprep import cli_doctor

    found = cli_doctor.look()
    is_well = all(each["status"] != "bad" for each in found)
    _show({"well": is_well, "findings": found}, cli_doctor.lines(found), as_json=as_json)
    if not is_well:
        raise typer.Exit(1)


def _show(summary: dict[str, Any], lines: list[str], *, as_json: bool) -> None:
    """Print a summary: one JSON object, or lines for people."""
    if as_json:
        print(json.dumps(summary))
        return
    for line in lines:
        print(_plain(line))


def _say_default_light(lights: list[str] | None) -> None:
    if not lights:
        print(
            "svprep: no --light SPEC is given; using dir:135,40 (azimuth 135, altitude 40)",
            file=sys.stderr,
        )


def main() -> None:
    """Run the command line and leave with its exit status; no traceback reaches a user."""
    # Compiling makes millions of short-lived objects that are in no cycle: look less often.
    gc.set_threshold(100_000, 20, 20)
    sys.exit(run())


def run(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit status; README lists what each one means."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that the locale cannot show is escaped
            stream.reconfigure(errors="backslashreplace")
    try:
        result = typer.main.get_command(app).main(
            args=arguments, prog_name="svprep", standalone_mode=False
        )
        status = result if isinstance(result, int) else 0
        if status == 130:  # Typer's own answer to Ctrl-C, without a word
            _complain("interrupted")
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except typer.Exit as stop:
        return stop.exit_code
    except SystemExit as stop:
        # Typer's own answer to a reader that has gone (svprep info | head).
        return 0 if isinstance(stop.__context__, BrokenPipeError) else int(stop.code or 0)
    except (typer.Abort, KeyboardInterrupt):
        _complain("interrupted")
        return 130
    except _UsageError as usage:
        text = usage.format_message()  # type: ignore[attr-defined]
        context = getattr(usage, "ctx", None)
        command = context.command_path if context is not None else "svprep"
        _complain(f"{text} ({command} --help lists the options)")
        return 2
    except SvprepError as error:
        _complain(str(error))
        return error.exit_status
    except BrokenPipeError:
        # The same, met by our own flush.
        _silence_output()
        return 0
    except MemoryError:
        _complain("out of memory; close other programs, or build parts of the model apart")
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else "the output cannot be written: "
        _complain(f"{where}{error.strerror or error}")
        _silence_output()
        return 1
    except Exception as bug:
        return _report_bug(bug)


def _complain(text: str) -> None:
    """Write one line to standard error, if there is one; control characters are escaped."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(f"svprep: {_plain(text)}", file=sys.stderr)


def _plain(text: str) -> str:
    """Return `text` on one line, without what would steer a terminal."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def _silence_output() -> None:
    """Drop what standard output still holds, so that leaving does not fail on it again."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report_bug(bug: Exception) -> int:
    """Write the traceback to a log file and say in one line where it is."""
    try:
        handle, name = tempfile.mkstemp(prefix="svprep-", suffix=".log")
        with os.fdopen(handle, "w") as log:
            log.write(f"svprep {__version__}, Python {sys.version}\n{sys.argv}\n")
            traceback.print_exception(bug, file=log)
    except OSError:
        name = "not written"
    _complain(f"this is a bug in svprep ({type(bug).__name__}: {bug}); log: {name}")
    return 70


def _cache_not_model(path: Path) -> Path:
    """Return `path`, or name the build command when it is a model file."""
    from svprep.errors import InputError

    model_suffixes = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
    if path.name.lower().removesuffix(".gz").endswith(model_suffixes):
        raise InputError(f"{path} is a model, not a cache. Run: svprep build {path}")
    return path


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a progress line on standard error while it is a terminal, else nothing."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda what, done, of: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    with Progress(
        TextColumn("{task.description:24}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task("", total=None)

        def tell(what: str, done: int, of: int) -> None:
            bar.update(task, description=what, completed=done, total=of)

        yield tell


def _build_summary(result: BuildResult) -> dict[str, Any]:
    return {
        "cache": str(result.cache.path),
        "n_bytes": result.cache.n_bytes,
        "content_digest": result.cache.content_digest,
        **_content_summary(result.prepared),
        "seconds": {name: round(s, 4) for name, s in result.seconds.items()},
    }


def _cache_summary(cache: Cache) -> dict[str, Any]:
    prepared = cache.prepared()
    return {
        "cache": str(cache.path),
        "n_bytes": cache.path.stat().st_size,
        "content_digest": cache.content_digest,
        "producer_version": cache.producer_version,
        "sources": [
            {"path": s.path, "format": s.format, "n_bytes": s.n_bytes, "sha256": s.sha256}
            for s in prepared.sources
        ],
        "config": prepared.config,
        "crs": cache.crs,
        "grid_origin_m": prepared.mesh.grid.origin_m.tolist(),
        "planar_tolerance_m": prepared.planes.tolerance_m,
        **_content_summary(prepared),
        "datasets": cache.dataset_sizes(),
    }


def _content_summary(prepared: Prepared) -> dict[str, Any]:
    """Return what `build` and `info` both say of a city."""
    from svprep import report
    from svprep.cli_clamp import light_facts

    return {
        "objects": len(prepared.object_names),
        "triangles_in": int(prepared.repair.source_triangles.sum()),
        "faces": len(prepared.mesh.faces),
        "vertices": len(prepared.mesh.positions),
        "planes": len(prepared.planes.planes),
        "edges": report.edge_counts(prepared.edges),
        **report.component_counts(prepared.components.flags),
        "index": report.index_counts(prepared.index),
        "clusters": len(prepared.scene.cluster_start) - 1,
        "lights": light_facts(prepared.clamp, prepared.mesh.grid),
        "grid_step_m": prepared.mesh.grid.step_m,
        "extent_m": report.extent_m(prepared.mesh),
        "left_out": len(report.left_out_faces(prepared)),
        "turned": len(prepared.repair.flipped_faces),
        "defects": report.total_counts(prepared.repair),
        "notes": list(prepared.notes),
    }


def _print_counts(summary: dict[str, Any]) -> None:
    from svprep import cli_clamp

    edges = summary["edges"]
    n_edges = edges["pair"] + edges["border"] + edges["split"]
    print(
        f"mesh     {summary['objects']:,} objects, {summary['faces']:,} faces "
        f"(of {summary['triangles_in']:,} triangles read), {summary['vertices']:,} vertices, "
        f"{summary['planes']:,} planes"
    )
    print(
        f"edges    {n_edges:,} records: {edges['pair']:,} pairs, {edges['border']:,} border, "
        f"{edges['split']:,} split; {edges['planar']:,} planar"
    )
    print(
        f"parts    {summary['components']:,} components, {summary['closed']:,} closed, "
        f"{summary['solid']:,} solid"
    )
    index = summary["index"]
    print(
        f"index    {index['objects']:,} objects have silhouette trees, over {index['edges']:,} "
        f"edges ({index['n_bytes'] / 1e6:.1f} MB)"
    )
    x, y, z = summary["extent_m"]
    print(f"extent   {x:,.2f} x {y:,.2f} x {z:,.2f} m (east, north, up)")
    print(f"grid     {summary['grid_step_m']:g} m; {summary['clusters']:,} clusters of faces")
    print(
        f"repair   {summary['left_out']:,} faces left out (no area on the grid, duplicates, "
        f"no surface), {summary['turned']:,} turned; all listed by --report"
    )
    for label, count in summary["defects"].items():
        print(f"found    {count:>10,}  {label}")
    for note in summary["notes"]:
        print(f"note     {_plain(note)}")
    for line in cli_clamp.light_lines(summary["lights"]):
        print(_plain(line))


def _print_build(summary: dict[str, Any]) -> None:
    _print_counts(summary)
    seconds = ", ".join(f"{name} {s:.2f}" for name, s in summary["seconds"].items())
    print(f"seconds  {sum(summary['seconds'].values()):.2f} ({seconds})")
    print(f"cache    {summary['cache']} ({summary['n_bytes'] / 1e6:.1f} MB)")


def _print_info(summary: dict[str, Any]) -> None:
    print(f"cache    {summary['cache']} ({summary['n_bytes'] / 1e6:.1f} MB)")
    print(f"digest   {summary['content_digest']}")
    print(f"made by  svprep {summary['producer_version']}, {json.dumps(summary['config'])}")
    for source in summary["sources"]:
        print(
            f"source   {source['path']} ({source['format']}, {source['n_bytes']:,} bytes, "
            f"SHA-256 {source['sha256'][:16]}...)"
        )
    x, y, z = summary["grid_origin_m"]
    print(f"origin   ({x:.3f}, {y:.3f}, {z:.3f}) m; CRS {summary['crs'] or 'not stated'}")
    _print_counts(summary)
    for name, size in summary["datasets"].items():
        print(f"bytes    {size:>13,}  {name}")


if __name__ == "__main__":
    main()

"""The command line: options in, one line per outcome out, exit status told.

Heavy modules are imported inside the commands that need them, so that
``svprep --help`` does not even load NumPy. Results go to standard output,
messages and progress to standard error; ``--json`` prints one object.

Annotations are objects here, not text as in every other module: Typer would
evaluate the text of 70 options twice, a tenth of the time of ``svprep --help``.
"""

import atexit
import contextlib
import gc
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from svprep import __version__
from svprep.cli_messages import complain, progress, report_bug, show, silence_output
from svprep.cli_options import (
    LIGHT_HELP,
    PICTURE_SIZE,
    CameraOption,
    ClampOption,
    ConstructionOption,
    CostAreaOption,
    CostVertexOption,
    CounterOption,
    JsonOption,
    LightsOption,
    MemoryOption,
    MethodOption,
    SamplesOption,
    SizeOption,
    ViewLightsOption,
    memory_of,
)
from svprep.errors import SvprepError
from svprep.frame_room import with_room_for_frames
from svprep.interrupts import keep_interrupts

_UsageError: type[Exception] = typer.BadParameter.__mro__[2]
"""Click's base exception, whether Typer brings Click along or depends on it."""

app = typer.Typer(
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Prepare city meshes for exact shadow volumes, and check what was prepared.",
)


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


@contextlib.contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Have a NumPy that is imported in the block start no threads, which spin for a while.

    Nothing in a build multiplies large matrices. A number that the user gave stays.
    """
    name = "OPENBLAS_NUM_THREADS"
    is_ours = name not in os.environ
    os.environ.setdefault(name, "1")
    try:
        yield
    finally:
        if is_ours:
            del os.environ[name]


@app.command()
def build(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="Models: .obj .ply .stl .off .glb .gltf .b3dm, CityJSON (.json .jsonl), CityGML "
            "(.gml .xml), or .gz of one; folders of them, or of 3D Tiles; quoted patterns.",
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
    lod: Annotated[
        str,
        typer.Option(
            metavar="L",
            help="Level of detail: highest, of each building with its parts; or a number.",
        ),
    ] = "highest",
    objects: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TYPE",
            help="Only objects of this type, such as Building (which takes its parts along). May "
            "be repeated.",
        ),
    ] = None,
    no_terrain: Annotated[bool, typer.Option("--no-terrain", help="Leave terrain out.")] = False,
    no_openings: Annotated[
        bool,
        typer.Option(
            "--no-openings", help="Leave windows and doors out; walls keep holes in their places."
        ),
    ] = False,
    crs: Annotated[
        str | None,
        typer.Option(
            metavar="CRS",
            help="Of files that state none, or one that is unknown; such as EPSG:28992.",
        ),
    ] = None,
    light: LightsOption = None,
    cost_vertex: CostVertexOption = None,
    cost_area: CostAreaOption = None,
    memory: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="About what to hold in memory at most, such as 512M or 1.5G (powers of 1024): "
            "the rest goes to files in the temporary folder, TMPDIR. The cache is the same. "
            "Default: all in memory.",
        ),
    ] = None,
    full: Annotated[
        bool,
        typer.Option(
            "--full",
            help="Build every object. Else those that an older CACHE of this name holds unchanged "
            "are taken from it; the result is the same.",
        ),
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write what was found and done per object (.json or .csv)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Read model files, repair them and write the cache."""
    from svprep import source_digest
    from svprep.process_memory import share_free_memory

    share_free_memory()
    source_digest.begin(inputs)
    with _one_blas_thread():
        from svprep import cli_build, cli_clamp

    config = cli_build.config_of(
        weld_tolerance,
        lod,
        objects or [],
        has_terrain=not no_terrain,
        has_openings=not no_openings,
        crs=crs,
    )
    costs = cli_clamp.costs_of(cost_vertex, cost_area)
    memory_bytes = None if memory is None else memory_of(memory, cli_build.LEAST_MEMORY)
    order = cli_build.Order(
        inputs, output, config, light or [], costs, report, memory_bytes, is_full=full
    )
    summary = cli_build.build(order, progress)
    show(summary, cli_build.build_lines(summary), as_json=as_json)
    if report is not None and not as_json:
        print(f"report   {report}")


@app.command()
def info(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")], as_json: JsonOption = False
) -> None:
    """Say what a cache holds: contents, sizes, defects found and repaired."""
    from svprep import cli_build

    summary = cli_build.describe(_cache_not_model(cache))
    show(summary, cli_build.info_lines(summary), as_json=as_json)


@app.command()
def export(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    output: Annotated[
        str,
        typer.Option("-o", "--output", metavar="FILE", help="A .glb, .obj, .ply or .city.json."),
    ],
    as_json: JsonOption = False,
) -> None:
    """Write the repaired mesh of a cache for other programs, its ids kept."""
    from svprep import cli_export

    summary = cli_export.run(_cache_not_model(cache), output)
    show(summary, cli_export.summary_lines(summary), as_json=as_json)


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
    size: SizeOption = PICTURE_SIZE,
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
    from svprep import cli_validate
    from svprep import validate as checks

    if explain is not None:
        text = checks.explain(explain)
        show({"code": explain, "text": text}, text.splitlines(), as_json=as_json)
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
        with progress() as tell:
            judged = cli_shadows.judge(_cache_not_model(cache), view_options, difference, tell)
        _say_default_light(light)
        show(judged, cli_shadows.summary_lines(judged), as_json=as_json)
        if not cli_shadows.is_clean(judged):
            raise typer.Exit(1)
        return
    usual = (None, None, PICTURE_SIZE, "auto", "auto", "float", "vertex", 1, None, None)
    given = (light or None, camera, size, method, clamp, counter, construction, samples, memory)
    if (*given, difference) != usual:
        raise typer.BadParameter("the options of a view (--light, --camera, ...) need --shadows")
    with progress() as tell:
        outcome = checks.validate(_cache_not_model(cache), deep=deep, on_step=tell)
    show(cli_validate.summary(outcome), cli_validate.lines(outcome), as_json=as_json)
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
        typer.Option(
            metavar="NAME", help="Only objects of exactly this name, and their parts; repeatable."
        ),
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
    show(summary, cli_silhouette.summary_lines(summary), as_json=as_json)


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
    with progress() as tell:
        summary = cli_clamp.add(_cache_not_model(cache), light or [], costs, tell)
    show(summary, cli_clamp.add_lines(summary), as_json=as_json)


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
    with progress() as tell:
        summary = cli_hours.answer(query, tell)
    show(summary, cli_hours.summary_lines(summary), as_json=as_json)


@app.command()
def render(
    cache: Annotated[Path, typer.Argument(metavar="CACHE")],
    light: ViewLightsOption = None,
    camera: CameraOption = None,
    size: SizeOption = PICTURE_SIZE,
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
    show(summary, cli_render.summary_lines(summary), as_json=as_json)


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
    show({"well": is_well, "findings": found}, cli_doctor.lines(found), as_json=as_json)
    if not is_well:
        raise typer.Exit(1)


def _say_default_light(lights: list[str] | None) -> None:
    if not lights:
        print(
            "svprep: no --light SPEC is given; using dir:135,40 (azimuth 135, altitude 40)",
            file=sys.stderr,
        )


@with_room_for_frames
def main() -> None:
    """Run the command line and leave with its exit status; no traceback reaches a user."""
    # Compiling makes millions of short-lived objects that are in no cycle: look less often.
    gc.set_threshold(250_000, 20, 20)
    keep_interrupts()
    _leave(run())


def _leave(status: int) -> NoReturn:
    """End the process without taking down what the system frees at once (0.35 s for a city).

    Files are closed and synced by then; what was to run at exit runs.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            try:
                stream.flush()
            except (OSError, ValueError):  # the reader has gone, or the disk is full
                status = status or 1
    os._exit(status)


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
            complain("interrupted")
        if sys.stdout is not None:
            sys.stdout.flush()
        return status
    except typer.Exit as stop:
        return stop.exit_code
    except SystemExit as stop:
        # Typer's own answer to a reader that has gone (svprep info | head).
        return 0 if isinstance(stop.__context__, BrokenPipeError) else int(stop.code or 0)
    except (typer.Abort, KeyboardInterrupt):
        complain("interrupted")
        return 130
    except _UsageError as usage:
        text = usage.format_message()  # type: ignore[attr-defined]
        context = getattr(usage, "ctx", None)
        command = context.command_path if context is not None else _command_of(arguments)
        complain(f"{text} ({command} --help lists the options)")
        return 2
    except SvprepError as error:
        complain(str(error))
        return error.exit_status
    except BrokenPipeError:
        # The same, met by our own flush.
        silence_output()
        return 0
    except MemoryError:
        complain("out of memory; close other programs, or build parts of the model apart")
        return 1
    except OSError as error:
        where = f"{error.filename}: " if error.filename else "the output cannot be written: "
        complain(f"{where}{error.strerror or error}")
        silence_output()
        return 1
    except Exception as bug:
        return report_bug(bug)


def _command_of(arguments: list[str] | None) -> str:
    """Return what the user called, ``svprep`` with the name of a command if there is one."""
    given = sys.argv[1:] if arguments is None else arguments
    known = getattr(typer.main.get_command(app), "commands", {})
    return f"svprep {given[0]}" if given and given[0] in known else "svprep"


def _cache_not_model(path: Path) -> Path:
    """Return `path`, or name the build command when it is a model file."""
    from svprep.errors import InputError
    from svprep.ingest.inputs import MODEL_SUFFIXES, is_tileset_folder, suffix_of_model

    if suffix_of_model(path) in MODEL_SUFFIXES or is_tileset_folder(path):
        raise InputError(f"{path} is a model, not a cache. Run: svprep build {path}")
    return path


if __name__ == "__main__":
    main()

"""Nothing leaks, whatever happens; and what goes wrong is told in the one line that is promised."""

from __future__ import annotations

import ctypes
import ctypes.util
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from svprep.cache.reader import open_cache
from svprep.cache.writer import write_cache
from svprep.errors import CacheError, EnvironmentProblem, InputError, InternalError, SvprepError
from svprep.model import Prepared
from svprep_runtime import context as contexts
from svprep_runtime import gl_raw as g
from svprep_runtime import programs
from svprep_runtime.context import Context, headless
from svprep_runtime.frame import Settings, draw, render
from svprep_runtime.measure import Meter
from svprep_runtime.scene import MOST_BATCHES, Scene
from svprep_runtime.targets import Targets
from tests.gpu.scenes import built, camera_of, every_setting, light_of
from tests.unit.cache_samples import nothing
from tests.unit.hours_scenes import box, level

MakeTargets = Callable[[int, int, int], Targets]
KINDS = ("Buffer", "Texture", "Framebuffer", "Program", "VertexArray", "Query")
SUN, OTHER_SUN, LAMP = "dir:127,38", "dir:200,20", "point:6.1,-8.3,9.2"


def live(context: Context) -> Counter[str]:
    """Count the objects of each kind that the driver knows by the first 2000 names.

    A released program lives on while it is the one in use: none is.
    """
    context.gl.glFinish()
    ctypes.CDLL(ctypes.util.find_library("GL")).glUseProgram(0)
    found: Counter[str] = Counter()
    for kind in KINDS:
        exists = getattr(context.gl, f"glIs{kind}")
        found[kind] = sum(exists(name) for name in range(1, 2001))
    return found


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return built(
        level(-16, -16, 16, 16),
        box((-3, -2, 1), (3, 2, 4)),
        box((4, -1, 0), (6, 1, 2), without=(0,)),
        lights=[SUN, LAMP],
    )


@pytest.fixture
def nothing_leaks(context: Context) -> Iterator[Context]:
    before = live(context)
    yield context
    with context.ctx:
        left = live(context)
        left.subtract(before)
        # Mesa itself holds on to the last program that had a geometry shader.
        assert left.pop("Program") <= 1
        assert not any(left.values()), left
        assert context.gl.glGetError() == 0


@pytest.fixture
def make_targets(nothing_leaks: Context) -> Iterator[MakeTargets]:
    made: list[Targets] = []

    def make(width_px: int, height_px: int, n_lights: int) -> Targets:
        made.append(Targets(nothing_leaks, width_px, height_px, n_lights))
        return made[-1]

    yield make
    for targets in made:
        targets.release()


def one_line(error: pytest.ExceptionInfo[SvprepError]) -> str:
    told = str(error.value)
    assert told
    assert "\n" not in told
    return told


# Nothing leaks -----------------------------------------------------------------------------------


def test_objects_are_counted(context: Context) -> None:
    before = live(context)
    buffer = context.ctx.buffer(reserve=16)
    assert live(context) - before == Counter(Buffer=1)
    buffer.release()
    assert live(context) == before


def test_scenes_and_targets_give_all_back(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    lights = [light_of(prepared, spec) for spec in (SUN, LAMP)]
    targets = make_targets(64, 64, 2)
    left = []
    for _ in range(3):
        with Scene(nothing_leaks, prepared) as scene:
            for one in every_setting(clamps=(False, True)):
                render(scene, targets, camera, lights, one)
        assert scene.memory.used_bytes == 0
        left.append(live(nothing_leaks))
    assert left[1:] == left[:-1]
    targets.release()  # twice does no harm
    scene.release()


def test_twenty_frames_make_no_more_objects_than_one(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    light = light_of(prepared, SUN)
    targets = make_targets(64, 64, 1)
    with Scene(nothing_leaks, prepared) as scene:
        render(scene, targets, camera, [light])
        before, used = live(nothing_leaks), scene.memory.used_bytes
        for _ in range(20):
            render(scene, targets, camera, [light])
        assert live(nothing_leaks) == before
        assert scene.memory.used_bytes == used


def test_measured_frames_leave_no_queries(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    light = light_of(prepared, SUN)
    targets = make_targets(64, 64, 1)
    with Scene(nothing_leaks, prepared) as scene:
        first = render(scene, targets, camera, [light], with_figures=True)
        assert {"see", "displace", "see again", "settle", "ambient", "z-pass", "light"} <= {
            one.name for one in first.figures
        }
        before = live(nothing_leaks)
        for _ in range(20):
            picture = render(scene, targets, camera, [light], with_figures=True)
            assert [one.name for one in picture.figures] == [one.name for one in first.figures]
        assert live(nothing_leaks) == before


def test_a_pass_that_fails_leaves_no_queries_either(nothing_leaks: Context) -> None:
    meter = Meter(nothing_leaks, is_on=True)
    for _ in range(3):
        with pytest.raises(ZeroDivisionError), meter.measure("see"):
            raise ZeroDivisionError
    assert meter.figures() == ()
    with meter.measure("see", 1):
        pass
    (figures,) = meter.figures()
    assert (figures.name, figures.light, figures.n_samples) == ("see", 1, 0)
    assert meter.figures() == ()


def test_a_meter_that_is_off_asks_nothing(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    with Scene(nothing_leaks, prepared) as scene:
        picture = render(scene, make_targets(64, 64, 1), camera, [light_of(prepared, SUN)])
    assert picture.figures == ()


def test_a_light_that_moves_leaves_nothing_behind(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    targets = make_targets(64, 64, 1)
    with Scene(nothing_leaks, prepared) as scene:
        used = []
        for altitude in range(20, 40):
            light = light_of(prepared, f"dir:127,{altitude}")
            render(scene, targets, camera, [light])
            scene.forget(light)
            scene.forget(light)  # of what is not there
            used.append((scene.memory.used_bytes, live(nothing_leaks)["Buffer"]))
        assert used[1:] == used[:-1]


def test_batches_are_kept_up_to_a_bound(nothing_leaks: Context, prepared: Prepared) -> None:
    with Scene(nothing_leaks, prepared) as scene:
        lit = scene.lit_by(light_of(prepared, SUN), clamped=True)
        n = len(lit.casters.is_closed)
        kept = scene.batch(lit, "vertex")
        for i in range(3 * MOST_BATCHES):
            scene.batch(lit, "vertex", np.arange(n) == i % n, whole=i >= n)
            assert scene.batch(lit, "vertex") is kept  # the one in use stays
            assert len(lit.batches) <= MOST_BATCHES
        assert live(nothing_leaks)["Buffer"] < 30


def test_a_second_context_leaves_the_first_alone(
    nothing_leaks: Context, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    light = light_of(prepared, SUN)

    def mask_in(context: Context) -> np.ndarray:
        targets = Targets(context, 64, 64, 1)
        with Scene(context, prepared) as scene:
            picture = render(scene, targets, camera, [light])
        targets.release()
        return picture.mask

    first = mask_in(nothing_leaks)
    with headless() as other:
        assert not any(live(other).values())
        np.testing.assert_array_equal(mask_in(other), first)
        assert not any(live(other).values())
    with nothing_leaks.ctx:
        np.testing.assert_array_equal(mask_in(nothing_leaks), first)


# Failures half-way -------------------------------------------------------------------------------


def test_a_budget_too_small_for_the_scene(nothing_leaks: Context, prepared: Prepared) -> None:
    for n_bytes, what in ((0, "positions"), (300, "faces")):
        with pytest.raises(EnvironmentProblem, match=f"the {what} take .* budget is") as error:
            Scene(nothing_leaks, prepared, budget_bytes=n_bytes)
        assert "--memory" in one_line(error)


@pytest.mark.parametrize("construction", ["vertex", "geometry"])
def test_a_budget_too_small_for_a_light(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared, construction: str
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    light = light_of(prepared, SUN)
    one = Settings(construction=construction)
    targets = make_targets(64, 64, 1)
    with Scene(nothing_leaks, prepared) as scene:
        used, whole = scene.memory.used_bytes, scene.memory.budget_bytes
        told = set()
        for more in range(0, 2000, 16):
            scene.memory.budget_bytes = used + more
            try:
                render(scene, targets, camera, [light], one)
                break
            except EnvironmentProblem as error:
                told.add(str(error).partition(" take ")[0])
            scene.forget(light)
            assert scene.memory.used_bytes == used, told
        names = {"the facing of faces", "the segments", "the volumes of a light"}
        own = {"vertex": "the edges", "geometry": "the neighbours of faces"}
        assert told == names | {own[construction]}
        scene.memory.budget_bytes = whole
        render(scene, targets, camera, [light], one)


def test_an_array_beyond_the_largest_buffer(
    nothing_leaks: Context, prepared: Prepared, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nothing_leaks, "most_buffer_bytes", 200)
    with pytest.raises(EnvironmentProblem, match="this driver allows 200") as error:
        Scene(nothing_leaks, prepared)
    one_line(error)


def test_sizes_that_cannot_be_drawn(nothing_leaks: Context) -> None:
    most = nothing_leaks.most_pixels_a_side
    for size in ((0, 64), (64, 0), (-1, 5), (most + 1, 1), (1, most + 1)):
        with pytest.raises(InputError, match=rf"{size[0]}x{size[1]} .*1 to {most}") as error:
            Targets(nothing_leaks, *size, 1)
        one_line(error)


def test_formats_that_the_driver_refuses(
    nothing_leaks: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    gl = nothing_leaks.gl
    for n_good in range(4):
        answers = iter([g.GL_FRAMEBUFFER_COMPLETE] * n_good + [0x8CDD] * 9)
        monkeypatch.setattr(gl, "glCheckNamedFramebufferStatus", lambda *_: next(answers))  # noqa: B023
        with pytest.raises(EnvironmentProblem, match=r"0x8cdd.*driver") as error:
            Targets(nothing_leaks, 16, 16, 1)
        one_line(error)


def test_graphics_memory_that_runs_out(
    nothing_leaks: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter([0, g.GL_OUT_OF_MEMORY])
    with monkeypatch.context() as patch:
        patch.setattr(nothing_leaks.gl, "glGetError", lambda: next(answers))
        with pytest.raises(EnvironmentProblem, match=r"no graphics memory.*16x16.*--size") as error:
            Targets(nothing_leaks, 16, 16, 1)
        one_line(error)


@pytest.mark.parametrize(
    ("stages", "file", "line"),
    [
        (("sides.vert", "count.frag"), "sides.vert", 28),
        (("sides.vert", "count.frag"), "position.glsl", 19),
        (("sides.vert", "count.frag"), "extrude.glsl", 16),
        (("sides.vert", "count.frag"), "count.frag", 8),
        (("volume.vert", "count.frag", "volume.geom"), "volume.geom", 40),
        (("volume.vert", "count.frag", "volume.geom"), "extrude.glsl", 16),
    ],
)
def test_a_shader_that_does_not_compile_is_told_with_file_and_line(
    context: Context,
    monkeypatch: pytest.MonkeyPatch,
    stages: tuple[str, ...],
    file: str,
    line: int,
) -> None:
    joined = programs.joined

    def broken(name: str, options: tuple[str, ...] = ()) -> programs.Source:
        source = joined(name, options)
        lines = source.text.splitlines()
        if (at := f"{file}:{line}") in source.origin:
            lines[source.origin.index(at)] = "no such thing;"
        return programs.Source("\n".join(lines) + "\n", source.origin)

    assert any(f"{file}:{line}" in joined(stage).origin for stage in stages)
    monkeypatch.setattr(programs, "joined", broken)
    before = live(context)
    made = programs.Programs(context)
    with pytest.raises(InternalError) as error:
        made.get(*stages, options=("AN_OPTION",))
    told = one_line(error)
    assert told.startswith(f"{file}:{line}: the driver refuses this shader: ")
    made.release()
    assert live(context) - before <= Counter(Program=1)  # moderngl leaves it there


def test_includes_are_joined_once_and_lines_keep_their_origin() -> None:
    for name in ("sides.vert", "volume.geom", "light.frag"):
        source = programs.joined(name, ("ONE", "TWO"))
        lines = source.text.splitlines()
        assert len(lines) == len(source.origin)
        assert lines[:3] == ["#version 450 core", "#define ONE 1", "#define TWO 1"]
        assert len(set(source.origin[3:])) == len(source.origin) - 3
        glsl = Path(programs.__file__).parent / "glsl"
        for text, at in list(zip(lines, source.origin, strict=True))[3:]:
            file, _, number = at.partition(":")
            assert (glsl / file).read_text("utf-8").splitlines()[int(number) - 1] == text
        assert "#include" not in source.text


def test_a_lamp_on_a_vertex(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    targets = make_targets(64, 64, 1)
    lamp = np.append(prepared.mesh.positions[5], np.float32(1.0))
    with Scene(nothing_leaks, prepared) as scene:
        used = scene.memory.used_bytes
        with pytest.raises(InputError, match="on a vertex") as error:
            render(scene, targets, camera, [lamp])
        one_line(error)
        assert scene.memory.used_bytes == used
        # A sun of the same three numbers is one.
        render(scene, targets, camera, [np.append(lamp[:3], np.float32(0.0))])


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (Settings(method="zpath"), "no method 'zpath'.*auto, zpass, zfail, zp+"),
        (Settings(construction="mesh"), "no construction 'mesh'.*vertex, geometry, triangles"),
        (Settings(counter="double"), "no counter 'double'.*float, stencil"),
        (Settings(samples=0), "0 samples"),
        (Settings(samples=-3), "-3 samples"),
        (Settings(samples=4), "4 samples have no majority"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_settings_that_name_nothing(
    nothing_leaks: Context,
    make_targets: MakeTargets,
    prepared: Prepared,
    settings: Settings,
    told: str,
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    targets = make_targets(64, 64, 1)
    with Scene(nothing_leaks, prepared) as scene:
        with pytest.raises(InputError, match=told.replace("zp+", r"zp\+")) as error:
            render(scene, targets, camera, [light_of(prepared, SUN)], settings)
        one_line(error)
        assert not scene.lit_by(light_of(prepared, SUN), clamped=True).batches


@pytest.mark.parametrize("size", [(64, 63, 1), (63, 64, 1), (128, 128, 1), (64, 64, 0)], ids=str)
def test_targets_of_another_picture(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared, size: tuple[int, ...]
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    lights = [light_of(prepared, SUN)]
    targets = make_targets(*size)
    told = rf"{size[0]}x{size[1]} pixels and {size[2]} lights, not 64x64 and 1"
    with Scene(nothing_leaks, prepared) as scene:
        for run in (
            lambda: render(scene, targets, camera, lights),
            lambda: draw(
                scene, targets, camera, lights, Settings(), Meter(nothing_leaks, is_on=False)
            ),
        ):
            with pytest.raises(InputError, match=told) as error:
                run()
            one_line(error)


def test_a_picture_without_lights_is_refused_and_a_night_is_drawn(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared
) -> None:
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    targets = make_targets(64, 64, 0)
    with Scene(nothing_leaks, prepared) as scene:
        with pytest.raises(InputError, match="at least one light") as error:
            render(scene, targets, camera, [])
        one_line(error)
        meter = Meter(nothing_leaks, is_on=True)
        assert draw(scene, targets, camera, [], Settings(), meter) == ()
    assert [one.name for one in meter.figures()] == [
        "see",
        "displace",
        "see again",
        "settle",
        "ambient",
    ]
    radiance, is_city = targets.read_radiance(), targets.read_seen() != 0
    assert is_city.any()
    assert (radiance[is_city].max(axis=-1) < 0.29).all()  # the sky's light alone
    assert (radiance[~is_city] == radiance[0, 0]).all()


def test_a_damaged_cache(nothing_leaks: Context, prepared: Prepared, tmp_path: Path) -> None:
    for dataset in ("mesh/positions", "mesh/face_corners", "edges/half_edges"):
        path = tmp_path / f"{dataset.replace('/', '_')}.svp.h5"
        write_cache(prepared, path)
        with h5py.File(path) as file:
            at = file[dataset].id.get_offset() + 9
        whole = bytearray(path.read_bytes())
        whole[at] ^= 0x40
        path.write_bytes(whole)
        with (
            open_cache(path) as cache,
            pytest.raises(CacheError) as error,
            Scene(nothing_leaks, cache) as scene,
        ):
            scene.lit_by(light_of(prepared, SUN), clamped=True)
        assert path.name in one_line(error)


def test_a_cache_draws_as_what_it_was_written_from(
    nothing_leaks: Context, make_targets: MakeTargets, prepared: Prepared, tmp_path: Path
) -> None:
    write_cache(prepared, tmp_path / "city.svp.h5")
    camera = camera_of(prepared, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0))
    lights = [light_of(prepared, spec) for spec in (SUN, OTHER_SUN, LAMP)]
    targets = make_targets(64, 64, 3)
    pictures = []
    with open_cache(tmp_path / "city.svp.h5") as cache:
        for of in (prepared, cache):
            with Scene(nothing_leaks, of) as scene:
                pictures.append(render(scene, targets, camera, lights))
    assert pictures[0].radiance.tobytes() == pictures[1].radiance.tobytes()
    assert [one.n_clamped_segments > 0 for one in pictures[1].tallies] == [True, False, True]


@pytest.mark.parametrize("one", every_setting(), ids=str)
def test_a_city_of_nothing_is_sky(
    nothing_leaks: Context, make_targets: MakeTargets, one: Settings
) -> None:
    empty = nothing()
    camera = camera_of(empty, (-9.0, -14.0, 12.0), (0.3, 0.2, 1.0), (8, 8))
    targets = make_targets(8, 8, 1)
    with Scene(nothing_leaks, empty) as scene:
        picture = render(scene, targets, camera, [light_of(empty, SUN)], one)
    assert not picture.mask.any()
    assert len(np.unique(picture.radiance.reshape(-1, 3), axis=0)) == 1


# No OpenGL, or too little of it ------------------------------------------------------------------


def enter(context: Callable[[], object]) -> None:
    with context():  # type: ignore[attr-defined]
        raise AssertionError("a context was made")


@pytest.mark.parametrize("missing", ["GL", "EGL"])
def test_a_missing_library_is_named_with_its_command(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setattr(
        contexts.ctypes.util, "find_library", lambda name: None if name == missing else "here"
    )
    with pytest.raises(EnvironmentProblem, match=rf"lib{missing}\b.*apt-get install") as error:
        enter(headless)
    one_line(error)


@pytest.mark.parametrize("missing", ["moderngl", "glcontext"])
def test_a_missing_package_is_named_with_its_command(
    monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(EnvironmentProblem, match=rf"{missing}.*pip install.*view") as error:
        enter(headless)
    one_line(error)


def test_a_display_without_a_driver_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    glcontext = pytest.importorskip("glcontext")

    def refuse(**_: object) -> None:
        raise RuntimeError("eglInitialize failed (0x3001)")

    monkeypatch.setattr(contexts.ctypes.util, "find_library", lambda name: name)
    monkeypatch.setattr(glcontext, "get_backend_by_name", lambda name: refuse)
    with pytest.raises(EnvironmentProblem, match=r"4\.5.*0x3001.*apt-get install") as error:
        enter(headless)
    one_line(error)


class Elsewhere:
    """Stands for a moderngl context of another driver."""

    def __init__(self, context: Context, version_code: int = 450) -> None:
        self.version_code = version_code
        self.info = {"GL_RENDERER": "Old Card", "GL_VERSION": "3.3 (Core)"}
        self._context = context


def test_an_old_or_poor_driver_is_told_what_it_lacks(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = address_of(context)
    with pytest.raises(EnvironmentProblem, match=r"4\.5 is needed; found Old Card.*3\.3") as error:
        contexts.checked(Elsewhere(context, 330), load)
    one_line(error)
    absent = ("glClipControl", "glStencilOpSeparate", "glCreateTextures", "glTextureStorage2D")
    with pytest.raises(
        EnvironmentProblem, match=r"and 1 more functions.*4\.5.*svprep doctor"
    ) as error:
        contexts.checked(Elsewhere(context), lambda name: 0 if name in absent else load(name))
    assert sum(name in one_line(error) for name in absent) == 3
    real = g.RawGL.integer
    for what, told in (
        (g.GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS, "8 storage buffers in vertex shaders"),
        (g.GL_MAX_GEOMETRY_SHADER_STORAGE_BLOCKS, "8 storage buffers in geometry shaders"),
        (g.GL_CLIP_DEPTH_MODE, "glClipControl"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(
                g.RawGL, "integer", lambda gl, name, at=what: 0 if name == at else real(gl, name)
            )
            with pytest.raises(EnvironmentProblem, match=f"{told}.*Old Card") as error:
                contexts.checked(Elsewhere(context), load)
            one_line(error)


def address_of(context: Context) -> Callable[[str], int]:
    """Return what finds functions of a current context."""
    return lambda name: ctypes.cast(getattr(context.gl, name), ctypes.c_void_p).value or 0

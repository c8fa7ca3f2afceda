"""`svprep render`, `validate --shadows`, `doctor` and `view`: what they write, say and refuse."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from svprep import cli
from svprep_runtime import drawing, frame
from svprep_runtime.context import APT, Context
from svprep_runtime.frame import Picture

ROOT = Path(__file__).resolve().parents[2]
EYE_M = 14.0
PIXELS_A_RADIAN = 24.0 / math.tan(math.radians(22.5))
FROM_ABOVE = ["--camera", f"0,0,{EYE_M:g},0,0,0,45", "--size", "64x48"]
EAST, STEEP, WEST = "dir:90,45", "dir:90,60", "dir:270,45"
LIGHT = ["--light", EAST]
PNG = b"\x89PNG\r\n\x1a\n"


def sheet(x0: float, y0: float, x1: float, y1: float, z: float) -> list[str]:
    """Return the lines of a level sheet that looks up."""
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return [f"v {x:g} {y:g} {z:g}" for x, y in corners] + ["f -4 -3 -2 -1"]


def town() -> str:
    """Return ground, an awning (open, so its volume is robust) and a box (closed), both aloft."""
    box = [f"v {x} {y} {z}" for z in (1, 2) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for quad in ("4 3 2 1", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8"):
        box.append("f " + " ".join(str(int(i) - 9) for i in quad.split()))
    return "\n".join(
        [
            *("o ground", *sheet(-6, -6, 6, 6, 0)),
            *("o awning", *sheet(2, 2, 4, 4, 2)),
            *("o box", *box),
            "",
        ]
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the cache of the town, clamped for the sun in the east."""
    folder = tmp_path_factory.mktemp("town")
    (folder / "town.obj").write_text(town())
    path = folder / "town.svp.h5"
    assert cli.run(["build", str(folder / "town.obj"), "-o", str(path), *LIGHT]) == 0
    return path


@pytest.fixture(autouse=True)
def in_folder(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder of its own, with a copy of the cache."""
    shutil.copy(cache, tmp_path)
    monkeypatch.chdir(tmp_path)


Run = Callable[..., list[str]]


@pytest.fixture
def said(capfd: pytest.CaptureFixture[str]) -> Run:
    """Return what runs a command that is well; it returns the lines of its output."""

    def run(*arguments: str, status: int = 0) -> list[str]:
        capfd.readouterr()
        assert cli.run(list(arguments)) == status
        out, err = capfd.readouterr()
        assert err == ""
        return out.splitlines()

    return run


@pytest.fixture
def told(said: Run) -> Callable[..., dict]:
    """Return what runs a command with ``--json``; it returns the only thing printed."""

    def run(*arguments: str, status: int = 0) -> dict:
        (line,) = said(*arguments, "--json", status=status)
        return json.loads(line)

    return run


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return what runs a command that fails with one line, and leaves all files as they are."""

    def run(*arguments: str, status: int = 1) -> str:
        before = files()
        capfd.readouterr()
        assert cli.run(list(arguments)) == status, arguments
        out, err = capfd.readouterr()
        assert out == ""
        assert err.startswith("svprep: ")
        assert err.count("\n") == 1, err
        assert "Traceback" not in err
        assert files() == before
        return err

    return run


def files() -> dict[str, bytes | None]:
    """Return all that is in the folder, by name: hidden and temporary files, too."""
    return {each.name: each.read_bytes() if each.is_file() else None for each in Path().iterdir()}


def pixels(path: str) -> np.ndarray:
    assert Path(path).read_bytes().startswith(PNG)
    with Image.open(path) as image:
        return np.array(image)


def expected_from_above(altitude_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which pixels of `FROM_ABOVE` are in shadow from the east, and which are sure."""
    row, column = np.mgrid[:48, :64] + 0.5
    across, up = (column - 32.0) / PIXELS_A_RADIAN, (24.0 - row) / PIXELS_A_RADIAN
    x, y = EYE_M * across, EYE_M * up
    x2, y2 = (EYE_M - 2.0) * across, (EYE_M - 2.0) * up  # at the height of roof and awning
    metre = 1.0 / math.tan(math.radians(altitude_deg))  # what a metre of height throws

    def inside(x: np.ndarray, y: np.ndarray, *box: float) -> np.ndarray:
        """Return how deep points are in a box, below 0 outside."""
        x0, y0, x1, y1 = box
        return np.minimum(np.minimum(x - x0, x1 - x), np.minimum(y - y0, y1 - y))

    lit = [inside(x2, y2, -1, -1, 1, 1), inside(x2, y2, 2, 2, 4, 4)]
    dark = [
        inside(x, y, -1 - 2 * metre, -1, 1 - metre, 1),
        inside(x, y, 2 - 2 * metre, 2, 4 - 2 * metre, 4),
    ]
    ground = inside(x, y, -6, -6, 6, 6)
    in_shadow = (np.max(dark, axis=0) > 0) & (np.max(lit, axis=0) < 0) & (ground > 0)
    is_sure = np.min(np.abs([*lit, *dark, ground]), axis=0) > 0.3
    return in_shadow, is_sure


# What is written, and what is said of it


def test_image_and_mask(context: Context, said: Run) -> None:
    lines = said("render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "-o", "a.png", "--mask", "m.png")
    assert [line.split()[0] for line in lines] == [
        *("picture", "light", "camera", "seconds", "image", "mask"),
    ]
    assert lines[-2:] == ["image    a.png", "mask     m.png"]
    assert set(files()) == {"a.png", "m.png", "town.svp.h5"}
    image, mask = pixels("a.png"), pixels("m.png")
    assert (image.shape, image.dtype) == ((48, 64, 3), np.uint8)
    assert (mask.shape, mask.dtype) == ((48, 64), np.uint8)
    assert np.unique(mask).tolist() == [0, 255]
    in_shadow, is_sure = expected_from_above(45.0)
    assert (is_sure & in_shadow).sum() > 20
    assert ((mask == 255) == in_shadow)[is_sure].all()
    assert (mask[:, :6] == 0).all()  # background
    # Dark in the picture is what the mask has in shadow; both are ground here.
    brightness = image.sum(axis=2)
    ground_row = brightness[24, 8:26]
    is_dark = mask[24, 8:26] == 255
    assert ground_row[is_dark].max() < 0.8 * ground_row[~is_dark].min()


def test_a_picture_of_ours_is_drawn_again_and_is_the_same(context: Context, said: Run) -> None:
    call = ["render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "-o", "a.png", "--mask", "m.png"]
    said(*call)
    before = files()
    said(*call)
    assert files() == before


def test_by_default_the_light_is_told_and_the_picture_is_named_after_the_cache(
    context: Context, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = Path("elsewhere")
    folder.mkdir()
    shutil.move("town.svp.h5", folder)
    capfd.readouterr()
    assert cli.run(["render", "elsewhere/town.svp.h5", "--size", "64x48", "--json"]) == 0
    out, err = capfd.readouterr()
    assert err == "svprep: no --light SPEC is given; using dir:135,40 (azimuth 135, altitude 40)\n"
    summary = json.loads(out)
    assert summary["image"] == "town.png"
    assert summary["mask"] is None
    assert [light["spec"] for light in summary["lights"]] == ["dir:135,40"]
    assert set(files()) == {"elsewhere", "town.png"}
    assert os.listdir(folder) == ["town.svp.h5"]
    # All of the model is in view, and no side of it touches the frame.
    seen = pixels("town.png")
    is_surface = (seen != seen[0, 0]).any(axis=2)
    assert is_surface.any()
    assert summary["surface_share"] == pytest.approx(is_surface.mean(), abs=0.02)
    assert not any(is_surface[edge].any() for edge in (0, -1, (slice(None), 0), (slice(None), -1)))


def test_of_several_lights_the_mask_is_what_none_reaches(
    context: Context, told: Callable[..., dict]
) -> None:
    call = ["render", "town.svp.h5", *FROM_ABOVE, "-o", "a.png", "--mask", "m.png"]
    both = told(*call, *LIGHT, "--light", STEEP)
    assert [light["spec"] for light in both["lights"]] == [EAST, STEEP]
    image, mask = pixels("a.png").sum(axis=2), pixels("m.png")
    low, sure_of_low = expected_from_above(45.0)
    steep, sure_of_steep = expected_from_above(60.0)
    is_sure = sure_of_low & sure_of_steep
    assert ((mask == 255) == (low & steep))[is_sure].all()
    row = np.zeros_like(is_sure)
    row[20:28, 8:26] = True  # ground, left of the box
    of_one = image[row & is_sure & low & ~steep]
    of_both = image[row & is_sure & low & steep]
    of_none = image[row & is_sure & ~low & ~steep]
    assert min(len(of_one), len(of_both), len(of_none)) > 0
    assert of_both.max() < of_one.min() <= of_one.max() < of_none.min()
    counted = [light["shadow_pixels"] for light in both["lights"]]
    for is_in, is_known, n in zip((low, steep), (sure_of_low, sure_of_steep), counted, strict=True):
        assert (is_in & is_known).sum() <= n <= (is_in | ~is_known).sum()
    opposite = told(*call, *LIGHT, "--light", WEST)
    assert all(light["shadow_pixels"] > 0 for light in opposite["lights"])
    assert {p["light"] for p in opposite["passes"]} == {None, 0, 1}


def test_the_camera_that_is_printed_draws_the_picture_again(
    context: Context, told: Callable[..., dict], said: Run
) -> None:
    call = ["render", "town.svp.h5", *LIGHT, "--size", "64x48"]
    first = told(*call, "-o", "a.png", "--mask", "m.png")
    lines = said(*call, "--camera", first["camera"], "-o", "b.png", "--mask", "n.png")
    (camera,) = (line for line in lines if line.startswith("camera"))
    assert camera.split() == ["camera", "--camera", first["camera"]]
    # The printed one is rounded to millimetres.
    assert np.mean(pixels("a.png") != pixels("b.png")) < 0.01
    assert np.mean(pixels("m.png") != pixels("n.png")) < 0.01
    said(*call, *camera.split()[1:], "-o", "c.png")
    assert Path("b.png").read_bytes() == Path("c.png").read_bytes()


def test_json_tells_what_each_pass_took(context: Context, told: Callable[..., dict]) -> None:
    got = told("render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "--mask", "m.png")
    assert set(got) == {
        "cache", "image", "mask", "size", "camera", "renderer", "opengl", "method", "counter",
        "construction", "samples", "surface_pixels", "surface_share", "buffer_bytes", "lights",
        "passes", "seconds",
    }  # fmt: skip
    assert (got["cache"], got["image"], got["mask"]) == ("town.svp.h5", "town.png", "m.png")
    assert got["size"] == [64, 48]
    assert (got["method"], got["counter"], got["construction"]) == ("auto", "float", "vertex")
    assert got["samples"] == 1
    assert got["opengl"].startswith("4.")
    assert got["buffer_bytes"] > 0
    assert got["surface_share"] == pytest.approx(got["surface_pixels"] / (64 * 48), abs=1e-6)
    (light,) = got["lights"]
    n = int((pixels("m.png") == 255).sum())
    assert light == {
        "spec": EAST,
        "words": "direction, azimuth 90, altitude 45",
        "shadow_pixels": n,
        "shadow_share": pytest.approx(n / got["surface_pixels"], abs=1e-6),
        "clamped_segments": light["clamped_segments"],
        "highest_count": 1,
        "negative_counts": 0,
    }
    assert light["clamped_segments"] > 0
    passes = {each["name"]: each for each in got["passes"]}
    assert list(passes) == ["see", "displace", "see again", "settle", "ambient", "z-pass", "light"]
    for each in got["passes"]:
        assert set(each) == {"name", "light", "ms", "wall_ms", "primitives", "samples"}
        assert each["ms"] >= 0.0
        assert each["wall_ms"] > 0.0
        assert each["primitives"] > 0
        assert each["samples"] > 0
    assert passes["see"]["light"] is None
    assert passes["light"]["light"] == passes["z-pass"]["light"] == 0
    assert passes["see"]["primitives"] == 2 + 2 + 12
    assert passes["light"]["samples"] == 64 * 48
    assert all(s >= 0.0 for s in got["seconds"].values())


def test_stats_say_the_same_to_people(context: Context, said: Run) -> None:
    lines = said("render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "--stats")
    passes = [line for line in lines if line.startswith("pass ")]
    names = ["see", "displace", "see again", "settle", "ambient", "z-pass", "light"]
    assert [line.split(":")[0] for line in passes] == [f"pass     {name}" for name in names]
    assert all(" ms, " in line and line.endswith(" samples") for line in passes)


def test_every_way_to_draw_gives_the_same_mask(context: Context, told: Callable[..., dict]) -> None:
    def drawn(*options: str) -> tuple[dict, np.ndarray]:
        call = ["render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "-o", "a.png", "--mask", "m.png"]
        return told(*call, *options), pixels("m.png")

    usual, mask = drawn()
    for options, key, value in (
        (["--method", "zpass"], "method", "zpass"),
        (["--method", "zfail", "--counter", "stencil"], "counter", "stencil"),
        (["--method", "zp+", "--clamp", "none"], "method", "zp+"),
        (["--method", "zfail", "--construction", "geometry"], "construction", "geometry"),
    ):
        got, same = drawn(*options)
        assert got[key] == value
        assert (same == mask).all(), options
        clamped = got["lights"][0]["clamped_segments"]
        assert clamped == (0 if "none" in options else usual["lights"][0]["clamped_segments"])
    several, _ = drawn("--samples", "3")
    assert several["samples"] == 3
    in_shadow, is_sure = expected_from_above(45.0)
    assert ((pixels("m.png") == 255) == in_shadow)[is_sure].all()
    assert np.unique(pixels("m.png")).tolist() == [0, 255]


# What is refused


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--size", "0x10"], '--size "0x10" is not WIDTHxHEIGHT'),
        (["--size", "10x0"], "WIDTHxHEIGHT"),
        (["--size", "10"], "WIDTHxHEIGHT"),
        (["--size", "-8x8"], "WIDTHxHEIGHT"),
        (["--size", "12.5x8"], "WIDTHxHEIGHT"),
        (["--method", "zfial"], '--method "zfial" is none of auto, zpass, zfail, zp+'),
        (["--clamp", "yes"], "none of auto, none"),
        (["--counter", "int"], "none of float, stencil"),
        (["--construction", "triangles"], "none of vertex, geometry"),
        (["--samples", "2"], "an odd number"),
        (["--samples", "0"], "an odd number"),
        (["--samples", "-1"], "an odd number"),
        (["--samples", "few"], "--samples"),
        (["--memory", "much"], '--memory "much" is not a size like 512M'),
        (["--memory", "-1k"], "not a size"),
        (["--memory", ""], "not a size"),
        (["--light", "sun:48,16,2026-03-20/06:00/18:00/1h[Europe/Vienna]"], "is an arc"),
        (["--frobnicate"], "--frobnicate"),
    ],
)
def test_usage_errors(options: list[str], says: str, refused: Callable[..., str]) -> None:
    for command in (["render"], ["validate", "--shadows"]):
        line = refused(*command, "town.svp.h5", *options, status=2)
        assert says in line
        assert f"svprep {command[0]} --help" in line


def test_usage_errors_of_judging_and_of_a_window(refused: Callable[..., str]) -> None:
    assert "CACHE" in refused("render", status=2)
    assert "CACHE" in refused("view", status=2)
    assert "name the cache" in refused("validate", "--shadows", status=2)
    for option in (LIGHT, FROM_ABOVE[:2], ["--difference", "d.png"]):
        line = refused("validate", "town.svp.h5", *option, status=2)
        assert "the options of a view (--light, --camera, ...) need --shadows" in line
    assert "WIDTHxHEIGHT" in refused("view", "town.svp.h5", "--size", "0x10", status=2)
    assert "none of auto" in refused("view", "town.svp.h5", "--method", "x", status=2)


def test_a_model_names_the_build_command(refused: Callable[..., str]) -> None:
    for command in (["render"], ["view"], ["validate", "--shadows"]):
        for name in ("city.obj", "city.GLB", "city.ply.gz"):
            line = refused(*command, name, *LIGHT)
            assert line == f"svprep: {name} is a model, not a cache. Run: svprep build {name}\n"


def damaged(dataset: str) -> None:
    with h5py.File("town.svp.h5") as file:
        offset = file[dataset].id.get_offset()
    whole = bytearray(Path("town.svp.h5").read_bytes())
    whole[offset] ^= 1
    Path("bad.svp.h5").write_bytes(whole)


def newer() -> None:
    shutil.copy("town.svp.h5", "bad.svp.h5")
    with h5py.File("bad.svp.h5", "r+") as file:
        file.attrs["schema_version"] = np.uint32(99)


def foreign() -> None:
    with h5py.File("bad.svp.h5", "w") as file:
        file["x"] = 1


def cut() -> None:
    whole = Path("town.svp.h5").read_bytes()
    Path("bad.svp.h5").write_bytes(whole[: len(whole) // 2])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: damaged("mesh/positions"), '"mesh/positions"'),
        (lambda: damaged("planes/d"), '"planes/d"'),
        (lambda: damaged("clamp/depth"), '"clamp/depth"'),
        (cut, "is cut off: "),
        (foreign, "not a svprep cache"),
        (lambda: Path("bad.svp.h5").write_text(town()), "expected an HDF5 file"),
        (lambda: Path("bad.svp.h5").touch(), "it is empty"),
        (lambda: Path("bad.svp.h5").mkdir(), "is a folder"),
        (newer, "schema 99"),
        (lambda: None, "there is no such file"),
    ],
    ids=[
        *("positions", "planes", "segments", "cut", "foreign", "text", "empty", "folder"),
        *("newer", "none"),
    ],
)
def test_caches_that_cannot_be_drawn(
    make: Callable[[], object], says: str, context: Context, refused: Callable[..., str]
) -> None:
    make()
    line = refused("render", "bad.svp.h5", *LIGHT, *FROM_ABOVE, "--json")
    assert line.startswith("svprep: bad.svp.h5")
    assert says in line


def test_what_cannot_be_drawn_is_one_line(
    context: Context, refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for options, says in (
        ([*LIGHT, "--memory", "0.1k"], "the budget is 102. Raise it with --memory"),
        ([*LIGHT, "--size", "16385x1"], "a picture of 16385x1 pixels cannot be made"),
        ([*LIGHT, "--size", "999999x999999"], "1 to 16384 each way"),
        (["--light", "point:-1,1,2"], "exactly on a vertex"),
        ([*LIGHT, "--light", "point:6,6,0"], "exactly on a vertex"),
        (["--light", "dir:here"], 'light "dir:here"'),
        ([*LIGHT, "--camera", "1,2,3,1,2,3"], "eye and target are the same point"),
        ([*LIGHT, "--camera", "1,2,3"], "expected six or seven numbers"),
        ([*LIGHT, "--camera", "1,2,3,4,5,nan"], "expected six or seven numbers"),
        ([*LIGHT, "--camera", "0,0,9,0,0,0,180"], "180 degrees cannot be drawn"),
    ):
        usual = [] if "--size" in options else ["--size", "64x48"]
        assert says in refused("render", "town.svp.h5", *options, *usual, "--mask", "m.png")
    monkeypatch.setattr("svprep_runtime.camera.MOST_PIXELS_A_SIDE", 999_999)
    line = refused("render", "town.svp.h5", *LIGHT, "--size", "200000x1")
    assert f"1 to {context.most_pixels_a_side} each way with this driver" in line


def test_only_pictures_of_ours_are_overwritten(refused: Callable[..., str]) -> None:
    Image.new("RGB", (4, 4)).save("holiday.png")
    Path("notes.png").write_text("not a picture")
    Path("folder.png").mkdir()
    shutil.copy("town.svp.h5", "cache.png")
    os.link("cache.png", "linked.png")
    os.symlink("cache.png", "shortcut.png")
    draw = ["render", "cache.png", *LIGHT, *FROM_ABOVE]
    for options, says in (
        (["-o", "holiday.png"], "holiday.png exists and is not a picture of svprep"),
        (["-o", "notes.png"], "is not overwritten"),
        (["-o", "folder.png"], "not a regular file"),
        (["-o", "cache.png"], "is an input, the cache itself or another output"),
        (["-o", "linked.png"], "the cache itself"),
        (["-o", "shortcut.png"], "the cache itself"),
        (["-o", "none/a.png"], "none"),
        (["-o", "a.jpg"], "a.jpg: pictures are written as .png"),
        (["-o", "a.png/"], "pictures are written as .png"),
        (["-o", "a.png", "--mask", "./a.png"], "name the mask otherwise"),
        (["-o", "a.png", "--mask", "cache.png"], "the cache itself"),
        (["-o", "a.png", "--mask", "holiday.png"], "is not overwritten"),
        (["-o", "a.png", "--mask", "none/m.png"], "none"),
        (["-o", "a.png", "--mask", "m.tif"], "masks are written as .png"),
    ):
        assert says in refused(*draw, *options)
    judge = ["validate", "--shadows", "cache.png", *LIGHT, *FROM_ABOVE]
    assert "is not overwritten" in refused(*judge, "--difference", "holiday.png")
    assert "the cache itself" in refused(*judge, "--difference", "cache.png")
    assert "none" in refused(*judge, "--difference", "none/d.png")
    Path("town.png").write_text("mine")
    assert "town.png exists" in refused("render", "town.svp.h5", *LIGHT)


# Rays judge


def test_rays_find_nothing_that_differs(
    context: Context, told: Callable[..., dict], said: Run
) -> None:
    call = ["validate", "--shadows", "town.svp.h5", *LIGHT, "--light", "point:-3,-4,5", *FROM_ABOVE]
    got = told(*call, "--difference", "d.png")
    assert set(got) == {
        "cache", "size", "camera", "renderer", "method", "constants", "lights", "difference",
        "seconds",
    }  # fmt: skip
    assert (got["size"], got["difference"]) == ([64, 48], "d.png")
    assert [light["spec"] for light in got["lights"]] == [EAST, "point:-3,-4,5"]
    for light in got["lights"]:
        assert set(light) == {
            "spec", "words", "surface_pixels", "decidable_pixels", "decidable_share",
            "differing_pixels", "differing", "shadow_in_sky", "negative_counts", "overlaps",
        }  # fmt: skip
        assert light["decidable_share"] > 0.6
        assert light["decidable_pixels"] <= light["surface_pixels"]
        assert (light["differing_pixels"], light["differing"]) == (0, [])
        assert (light["shadow_in_sky"], light["negative_counts"]) == (0, 0)
        assert light["overlaps"] == []
    assert pixels("d.png").shape == (48, 64, 3)
    assert (pixels("d.png") != (255, 0, 0)).any(axis=2).all()
    lines = said(*call, "--method", "zfail", "--clamp", "none")
    assert lines[-1] == "valid"
    assert "64 x 48; zfail, " in lines[0]
    assert not any(line.startswith(("differs", "image")) for line in lines)
    assert sum("0 of them differ" in line for line in lines) == 2


def flipped(at: list[tuple[int, int]]) -> Callable[..., Picture]:
    """Return a renderer that is wrong at these pixels."""

    def render(*arguments: object, **options: object) -> Picture:
        picture = frame.render(*arguments, **options)
        for pixel in at:
            picture.in_shadow[0][pixel] ^= True
        return picture

    return render


def test_a_pixel_that_differs_is_named(
    context: Context,
    told: Callable[..., dict],
    said: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    roof, shadow, sky = (24, 32), (24, 22), (5, 2)
    monkeypatch.setattr(drawing, "render", flipped([roof, shadow, sky]))
    call = ["validate", "--shadows", "town.svp.h5", *LIGHT, *FROM_ABOVE]
    got = told(*call, status=1)["lights"][0]
    cause = {"cause": "not found"}  # nothing in float64 speaks for a pixel that was turned over
    assert got["differing"] == [
        {"row": 24, "column": 22, "object": "ground", "by_rays": "shadow", **cause},
        {"row": 24, "column": 32, "object": "box", "by_rays": "lit", **cause},
    ]
    assert (got["differing_pixels"], got["shadow_in_sky"]) == (2, 1)
    lines = said(*call, "--difference", "d.png", status=1)
    assert [line for line in lines if line.startswith(("differs", "why"))] == [
        "differs  row 24, column 22: ground, shadow by rays, drawn otherwise",
        "why      not found",
        "differs  row 24, column 32: box, lit by rays, drawn otherwise",
        "why      not found",
        "differs  pixels of sky that show a surface: 1",
    ]
    assert lines[-1].startswith("not valid: pixels differ from rays")
    assert "image    d.png" in lines
    is_red = (pixels("d.png") == (255, 0, 0)).all(axis=2)
    assert np.argwhere(is_red).tolist() == [list(shadow), list(roof)]


def test_volumes_that_are_not_drawn_are_found_out(
    context: Context, told: Callable[..., dict], said: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def count(_scene: object, targets: object, *_rest: object) -> None:
        targets.clear_count(0, "float")  # type: ignore[attr-defined]

    monkeypatch.setattr(frame, "_count", count)
    call = ["validate", "--shadows", "town.svp.h5", *LIGHT, *FROM_ABOVE]
    got = told(*call, status=1)["lights"][0]
    in_shadow, is_sure = expected_from_above(45.0)
    n = got["differing_pixels"]
    assert n == len(got["differing"]) >= (in_shadow & is_sure).sum() > 12
    assert {each["by_rays"] for each in got["differing"]} == {"shadow"}
    lines = said(*call, status=1)
    assert sum(line.startswith("differs  row") for line in lines) == 12
    assert f"differs  ... and {n - 12} more (--json)" in lines


# What the machine has


def test_the_doctor_finds_this_machine_well(
    context: Context, told: Callable[..., dict], said: Run
) -> None:
    got = told("doctor")
    assert set(got) == {"well", "findings"}
    assert got["well"] is True
    found = {each["name"]: each for each in got["findings"]}
    assert all(set(each) == {"name", "status", "found", "remedy"} for each in got["findings"])
    for name in ("depth bits", "stencil bits", "clip control", "sub-pixel bits", "counting"):
        assert found[name]["status"] == "good"
    assert found["depth bits"]["found"].startswith("32")
    assert found["stencil bits"]["found"] == "8"
    assert context.renderer in found["OpenGL"]["found"]
    assert found["moderngl"]["status"] == found["libEGL"]["status"] == "good"
    lines = said("doctor")
    assert len(lines) == len(got["findings"]) + 1
    assert lines[-1].startswith("well")


@pytest.mark.parametrize(
    ("package", "command", "says"),
    [
        ("moderngl", "render", "\"moderngl\", which is not installed. Run: .* 'svprep[view]'"),
        ("glcontext", "render", "\"glcontext\", which is not installed. Run: .* 'svprep[view]'"),
        ("PIL", "render", "\"Pillow\", which is not installed. Run: .* 'svprep[view]'"),
        ("moderngl", "validate", "drawing needs .* 'svprep[view]'"),
        ("embreex.rtcore_scene", "validate", "judging shadows needs .* 'svprep[judge]'"),
    ],
)
def test_a_package_that_is_missing_names_its_extra(
    package: str,
    command: str,
    says: str,
    context: Context,
    refused: Callable[..., str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    options = ["--shadows"] if command == "validate" else ["-o", "a.png"]
    line = refused(command, "town.svp.h5", *LIGHT, *FROM_ABOVE, *options)
    where = 0
    for part in says.split(".*"):
        where = line.index(part.strip(), where)
    assert "-m pip install 'svprep[" in line


ELSEWHERE = """
import json, sys
from svprep import cli
for name in sys.argv[2:]:
    sys.modules[name] = None
for command in json.loads(sys.argv[1]):
    status = cli.run(command)
    for stream in (sys.stdout, sys.stderr):
        print(f"==== {status}", file=stream, flush=True)
"""
Answers = dict[str, tuple[int, str, str]]
DRAWING = {
    "render": ["render", "town.svp.h5", *LIGHT, *FROM_ABOVE, "-o", "a.png", "--mask", "m.png"],
    "validate": ["validate", "--shadows", "town.svp.h5", *LIGHT, *FROM_ABOVE],
    "view": ["view", "town.svp.h5", *LIGHT],
    "doctor": ["doctor"],
    "doctor --json": ["doctor", "--json"],
}


def elsewhere(folder: Path, *blocked: str, **variables: str) -> Answers:
    """Return status, output and errors of commands in one process on another machine.

    It has no display, none of the modules `blocked`, and these environment variables.
    """
    environment = {
        **{k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")},
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "runtime")]),
        **variables,
    }
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, json.dumps(list(DRAWING.values())), *blocked],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    out, err = (stream.split("==== ") for stream in (done.stdout, done.stderr))
    answers: Answers = {}
    for i, name in enumerate(DRAWING):
        texts = [parts[i].partition("\n")[2] if i else parts[0] for parts in (out, err)]
        answers[name] = (int(out[i + 1].split("\n")[0]), *texts)
    return answers


@pytest.fixture(scope="module")
def without_driver(cache: Path) -> Answers:
    """Return what commands answer where EGL finds no driver and there is no display."""
    answers = elsewhere(cache.parent, __EGL_VENDOR_LIBRARY_FILENAMES="/dev/null")
    assert sorted(os.listdir(cache.parent)) == ["town.obj", "town.svp.h5"]
    return answers


def test_without_a_driver_the_packages_are_named(context: Context, without_driver: Answers) -> None:
    for name in ("render", "validate"):
        status, out, err = without_driver[name]
        assert (status, out) == (1, "")
        assert err.startswith("svprep: no OpenGL 4.5 context could be made without a window (EGL: ")
        assert err.endswith(f" {APT}\n")
        assert err.count("\n") == 1


def test_without_a_driver_the_doctor_says_so(context: Context, without_driver: Answers) -> None:
    status, out, err = without_driver["doctor"]
    assert (status, err) == (1, "")
    assert out.endswith("not well: OpenGL\n")
    (line,) = (each for each in out.splitlines() if each.startswith("bad"))
    assert line.startswith("bad      OpenGL: no OpenGL 4.5 context")
    assert APT in line
    status, out, err = without_driver["doctor --json"]
    assert (status, err, out.count("\n")) == (1, "", 1)
    got = json.loads(out)
    assert got["well"] is False
    (bad,) = (each for each in got["findings"] if each["status"] == "bad")
    assert bad["name"] == "OpenGL"
    assert APT in bad["found"]
    (window,) = (each for each in got["findings"] if each["name"] == "window")
    assert (window["status"], window["found"]) == ("missing", "no display, for svprep view")


def test_without_a_display_there_is_no_window(context: Context, without_driver: Answers) -> None:
    status, out, err = without_driver["view"]
    assert (status, out) == (1, "")
    assert err.startswith("svprep: no window can be opened (DISPLAY is not set")
    assert "svprep render CACHE -o IMAGE" in err
    assert err.count("\n") == 1


def test_without_any_extra_each_command_names_its_own(cache: Path) -> None:
    packages = ("moderngl", "glcontext", "moderngl_window", "PIL", "embreex")
    answers = elsewhere(cache.parent, *packages)
    for name in ("render", "validate", "view"):
        status, out, err = answers[name]
        assert (status, out) == (1, ""), name
        assert err.count("\n") == 1, err
        extra = "judge" if name == "validate" else "view"
        assert f"-m pip install 'svprep[{extra}]'\n" in err
    assert "moderngl" in answers["doctor"][1]
    assert answers["doctor"][2] == ""
    assert sorted(os.listdir(cache.parent)) == ["town.obj", "town.svp.h5"]

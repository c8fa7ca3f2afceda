"""Whatever happens to a file's bytes: it is named, or it changes nothing that is read."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from svprep.cache import schema
from svprep.cache.reader import open_cache
from svprep.cache.verify import CHECKS, verify
from svprep.cache.writer import write_cache
from svprep.errors import CacheError
from svprep.model import Labels, Prepared
from tests.unit.cache_samples import (
    assert_same,
    no_lights,
    no_trees,
    one_cluster_each,
    strip_and_tetrahedron,
    two_spheres,
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cache") / "sound.svp.h5"
    write_cache(strip_and_tetrahedron(), path)
    return path


@pytest.fixture
def copy(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(sound, tmp_path / "copy.svp.h5"))


def found_in(path: Path) -> list[str]:
    """Return the codes that `verify` reports, or ``["CacheError"]``."""
    try:
        return [problem.code for problem in verify(path)]
    except CacheError as error:
        message = str(error)
    assert "\n" not in message
    assert str(path) in message
    return ["CacheError"]


def reads_as_before(path: Path) -> bool:
    """Whether everything a reader can see is there and equal to what was written.

    This is what decides that a flipped byte lies in HDF5's slack (free space
    and reserved fields that no reader looks at): nothing read has changed.
    """
    with open_cache(path) as cache:
        assert_same(cache.prepared(), strip_and_tetrahedron())
        assert cache.crs == "EPSG:7415"
        assert cache.producer_version
    return True


def test_flipped_bytes_are_found(copy: Path) -> None:
    data = copy.read_bytes()
    rng = random.Random(20_260_321)
    n_slack = 0
    for offset in rng.sample(range(len(data)), 200):
        damaged = bytearray(data)
        damaged[offset] ^= 1 << rng.randrange(8)
        copy.write_bytes(damaged)
        if not found_in(copy):
            assert reads_as_before(copy), offset
            n_slack += 1
    # HDF5 1.8's structures have checksums of their own: little of a file is slack.
    assert n_slack <= 20


@pytest.mark.parametrize("path", [*(spec.path for spec in schema.DATASETS), "digests"])
def test_a_flipped_byte_in_a_dataset_is_named(path: str, copy: Path) -> None:
    with h5py.File(copy, locking=False) as file:
        dataset = file[path]
        first, n_bytes = dataset.id.get_offset(), dataset.nbytes
    data = copy.read_bytes()
    for offset in sorted({0, n_bytes // 2, n_bytes - 1}):
        damaged = bytearray(data)
        damaged[first + offset] ^= 0x10
        copy.write_bytes(damaged)
        problems = verify(copy)
        if path == "digests":
            assert {p.code for p in problems} <= {"V201", "V202"}
            assert problems
            with pytest.raises(CacheError, match="digest"):
                open_cache(copy)
            continue
        # One damaged dataset is one line: what depends on it is not reported as well.
        assert [(p.code, p.where) for p in problems] == [("V201", path)]
        with open_cache(copy) as cache, pytest.raises(CacheError, match=path) as caught:
            cache.prepared()
        assert str(caught.value).startswith(
            f'{copy} is damaged: the dataset "{path}" cannot be used (its bytes are not those that '
            "were written). Build it again: svprep build models/sample.obj "
            f"'models/zweite Datei.ply' -o {copy}"
        )


def test_the_advice_names_what_it_can(tmp_path: Path) -> None:
    path = tmp_path / "a cache.h5"
    sample = strip_and_tetrahedron()
    many = replace(sample, sources=sample.sources * 3, config={})
    welded = replace(many, config={"weld_tolerance_m": 0.01})
    for prepared, options in ((many, ""), (welded, " --weld-tolerance 0.01")):
        write_cache(prepared, path)
        with h5py.File(path, "r+", libver=schema.LIBVER) as file:
            del file["planes/d"]
        with pytest.raises(CacheError) as caught:
            open_cache(path)
        assert str(caught.value) == (
            f'{path} is damaged: the dataset "planes/d" is missing or cannot be read. '
            f"Build it again: svprep build SOURCE -o '{path}'{options}"
        )


def test_truncated_files_are_refused(copy: Path) -> None:
    data = copy.read_bytes()
    for length in [1, 8, 47, 48, *np.linspace(0, len(data) - 1, 50).astype(int).tolist()]:
        copy.write_bytes(data[:length])
        with pytest.raises(CacheError) as caught:
            open_cache(copy)
        if length < 8:
            assert "is not a cache: it " in str(caught.value)
        else:
            of = (
                f": {length:,} of {len(data):,} bytes" if length >= 48 else f" after {length} bytes"
            )
            assert str(caught.value) == (
                f"{copy} is cut off{of}. Build it again: svprep build SOURCE -o {copy}"
            )
        assert found_in(copy) == ["CacheError"]


def test_random_garbage_never_raises_anything_else(copy: Path) -> None:
    data = copy.read_bytes()
    rng = random.Random(7)
    for _ in range(150):
        damaged = bytearray(data)
        for _ in range(rng.choice([1, 4, 64])):
            at = rng.randrange(len(damaged))
            chunk = rng.randbytes(rng.choice([1, 8, 300]))
            damaged[at : at + len(chunk)] = chunk
        copy.write_bytes(damaged)
        if not found_in(copy):
            assert reads_as_before(copy)


def test_foreign_files(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    with pytest.raises(CacheError, match="no such file"):
        open_cache(path)
    with pytest.raises(CacheError, match="folder"):
        open_cache(tmp_path)
    path.write_bytes(b"v 0 0 0\n")
    with pytest.raises(CacheError, match=r'begins with "v 0 0 0".*svprep build MODEL') as caught:
        open_cache(path)
    assert str(caught.value).startswith(f"{path} is not a cache: ")
    path.write_bytes(b"\0\1\2")
    with pytest.raises(CacheError, match="the bytes 00 01 02"):
        open_cache(path)
    with h5py.File(path, "w") as file:
        file["data"] = np.arange(3)
    with pytest.raises(CacheError, match="not a svprep cache"):
        open_cache(path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CacheError, match="not a regular file"):
        open_cache(tmp_path / "pipe")


@pytest.mark.parametrize(("version", "advice"), [(6, "Upgrade"), (4, "svprep build")])
def test_another_schema(version: int, advice: str, copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file.attrs.modify("schema_version", np.uint32(version))
        file.attrs.modify("producer_version", np.bytes_("7.1"))
    with pytest.raises(CacheError, match=rf"svprep 7\.1 with schema {version}.*{advice}"):
        open_cache(copy)


def _delete(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]

    return change


def _store(name: str, value: object, **options: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, data=value, **options)

    return change


def _attribute(name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file.attrs[name]
        if value is not None:
            file.attrs[name] = value

    return change


def _link(name: str, link: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = link

    return change


FORGERIES: dict[str, tuple[Callable[[h5py.File], None], tuple[str, str]]] = {
    "missing": (_delete("edges/flags"), ("V101", "edges/flags")),
    "missing digests": (_delete("digests"), ("V101", "digests")),
    "missing group": (_delete("mesh"), ("V101", "mesh/positions")),
    "dtype": (_store("edges/flags", np.zeros(11, "<u2")), ("V102", "edges/flags")),
    "length": (_store("edges/flags", np.zeros(10, "u1")), ("V102", "edges/flags")),
    "rank": (_store("planes/d", np.zeros((5, 1))), ("V102", "planes/d")),
    "byte order": (_store("planes/d", np.zeros(5, ">f8")), ("V102", "planes/d")),
    "chunked": (_store("planes/d", np.zeros(5), chunks=(5,)), ("V102", "planes/d")),
    "group": (lambda f: (_delete("planes/d")(f), f.create_group("planes/d")), ("V102", "planes/d")),
    "huge": (
        lambda f: (
            _delete("repair/flipped_faces")(f),
            f.create_dataset("repair/flipped_faces", (2**40,), "<u4"),
        ),
        ("V102", "repair/flipped_faces"),
    ),
    "unknown": (_store("mesh/colour", np.zeros(3)), ("V103", "mesh/colour")),
    "unknown group": (lambda f: f.create_group("COLOURS"), ("V103", "COLOURS")),
    "no group for ParaView": (_delete("VTKHDF"), ("V101", "VTKHDF")),
    "no offsets for ParaView": (
        _delete("VTKHDF/Polygons/Offsets"),
        ("V101", "VTKHDF/Polygons/Offsets"),
    ),
    "other offsets for ParaView": (
        _store("VTKHDF/Polygons/Offsets", np.arange(7, dtype="<i4")),
        ("V106", "VTKHDF/Polygons/Offsets"),
    ),
    "wide offsets for ParaView": (
        _store("VTKHDF/Polygons/Offsets", np.arange(0, 19, 3)),
        ("V106", "VTKHDF/Polygons/Offsets"),
    ),
    "objects for ParaView packed": (
        _store("VTKHDF/CellData/object", np.array([0, 0, 1, 1, 1, 1], "<i4"), compression="gzip"),
        ("V106", "VTKHDF/CellData/object"),
    ),
    "a group for a dataset": (
        lambda f: (
            _delete("VTKHDF/CellData/object")(f),
            f.create_group("VTKHDF/CellData/object"),
        ),
        ("V106", "VTKHDF/CellData/object"),
    ),
    "a copy for ParaView": (
        lambda f: _store("VTKHDF/Points", f["mesh/positions"][...])(f),
        ("V106", "VTKHDF/Points"),
    ),
    "soft link for ParaView": (
        _link("VTKHDF/Points", h5py.SoftLink("/mesh/positions")),
        ("V101", "VTKHDF/Points"),
    ),
    "another file for ParaView": (
        _link("VTKHDF/CellData", h5py.ExternalLink("/none.h5", "d")),
        ("V101", "VTKHDF/CellData/plane"),
    ),
    "more for ParaView": (
        _store("VTKHDF/CellData/colour", np.zeros(6)),
        ("V103", "VTKHDF/CellData/colour"),
    ),
    "type for ParaView": (
        lambda f: f["VTKHDF"].attrs.modify("Type", np.bytes_("ImageDat")),
        ("V106", "VTKHDF"),
    ),
    "no version for ParaView": (
        lambda f: f["VTKHDF"].attrs.__delitem__("Version"),
        ("V106", "VTKHDF"),
    ),
    "extra attribute": (lambda f: f.attrs.create("x", 1), ("V103", "attribute x")),
    "loop": (_link("planes/d", h5py.SoftLink("/planes/d")), ("V102", "planes/d")),
    "outside": (_link("planes/d", h5py.ExternalLink("/none.h5", "d")), ("V102", "planes/d")),
    "no attribute": (_attribute("notes", None), ("V101", "attribute notes")),
    "text": (_attribute("config", "variable length"), ("V102", "attribute config")),
    "not JSON": (_attribute("config", np.bytes_("{")), ("V105", "attribute config")),
    "deep JSON": (_attribute("notes", np.bytes_("[" * 60_000)), ("V105", "attribute notes")),
    "list": (_attribute("config", np.bytes_("[]")), ("V105", "attribute config")),
    "sources": (_attribute("sources", np.bytes_("[3, 4]")), ("V105", "attribute sources")),
    "step": (_attribute("grid_step_m", np.float64(0.3)), ("V105", "attribute grid_step_m")),
    "step nan": (_attribute("grid_step_m", np.float64("nan")), ("V105", "attribute grid_step_m")),
    "origin": (
        _attribute("grid_origin_m", np.array([0.1, 0, 0])),
        ("V105", "attribute grid_origin_m"),
    ),
    "tolerance": (
        _attribute("planar_tolerance_m", np.float64(-1)),
        ("V105", "attribute planar_tolerance_m"),
    ),
    "note": (_attribute("notes", np.bytes_('["!"]')), ("V202", "digest table or attributes")),
    "producer": (
        _attribute("producer_version", np.bytes_("0.0")),
        ("V202", "digest table or attributes"),
    ),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_forged_structure_is_named(name: str, copy: Path) -> None:
    change, expected = FORGERIES[name]
    with h5py.File(copy, "r+", libver=schema.LIBVER) as file:
        change(file)
    problems = verify(copy)
    assert expected in [(p.code, p.where) for p in problems], [str(p) for p in problems]
    assert all(p.code in CHECKS and "\n" not in str(p) for p in problems)
    # svprep does not read what it shows to ParaView.
    if expected[0] not in ("V103", "V105") and not expected[1].startswith("VTKHDF"):
        with pytest.raises(CacheError), open_cache(copy) as cache:
            cache.prepared()


def rewrite(path: Path, **arrays: np.ndarray) -> None:
    """Replace datasets of a cache and set all digests right: a writer's bug, not damage."""
    with h5py.File(path, "r+", libver=schema.LIBVER) as file:
        for name, array in arrays.items():
            if file[name].shape == array.shape:
                file[name][...] = array
            else:
                del file[name]
                file.create_dataset(name, data=array, track_times=False)
        table = [
            (s.path, schema.item_digest(s.path, s.dtype, file[s.path][...]))
            for s in schema.DATASETS
        ]
        rows = [(name.encode(), digest.encode()) for name, digest in table]
        file["digests"][...] = np.array(rows, schema.DIGESTS_DTYPE)
        values = {s.name: np.asarray(file.attrs[s.name]) for s in schema.ATTRIBUTES}
        plain = {n: bytes(v[()]) if v.dtype.kind == "S" else v for n, v in values.items()}
        content = schema.content_digest(plain, table)
        file.attrs.modify("content_digest", np.bytes_(content))
        file.attrs.modify("root_digest", np.bytes_(schema.root_digest(content, plain)))


NONE = 0xFFFFFFFF
# (dataset, index, value), then what must be reported.
BUGS: dict[str, tuple[tuple[str, object, object], tuple[str, str]]] = {
    "offsets fall": (("objects/name_start", 1, 99), ("V301", "objects/name_start")),
    "offsets end": (("components/edge_start", 2, 10), ("V301", "components/edge_start")),
    "vertex": (("mesh/face_corners", 4, 8), ("V302", "mesh/face_corners")),
    "plane": (("planes/plane_of_face", 0, 5), ("V302", "planes/plane_of_face")),
    "source": (("objects/source", 0, 2), ("V302", "objects/source")),
    "half-edge": (("edges/half_edges", (0, 0), 18), ("V302", "edges/half_edges")),
    "nan": (("mesh/positions", (1, 1), np.nan), ("V303", "mesh/positions")),
    "inf": (("mesh/positions", (1, 1), np.inf), ("V303", "mesh/positions")),
    "off grid": (("mesh/positions", (1, 1), 2.0**-12), ("V303", "mesh/positions")),
    "far": (("mesh/positions", (1, 1), 8192.5), ("V303", "mesh/positions")),
    "edge bits": (("edges/flags", 0, 9), ("V304", "edges/flags")),
    "edge kind 3": (("edges/flags", 0, 3), ("V304", "edges/flags")),
    "solid, not closed": (("components/flags", 0, 2), ("V304", "components/flags")),
    "corner twice": (("mesh/face_corners", 1, 0), ("V305", "mesh/face_corners")),
    "foreign vertex": (("mesh/face_corners", 1, 5), ("V305", "mesh/face_corners")),
    "half-edge twice": (("edges/half_edges", (0, 0), 1), ("V401", "edges/half_edges")),
    "half-edge missing": (("edges/half_edges", (3, 1), NONE), ("V401", "edges/half_edges")),
    "empty record": (("edges/half_edges", (0, 0), NONE), ("V402", "edges/half_edges")),
    "turned record": (
        ("edges/half_edges", (1, slice(None)), [2, NONE]),
        ("V402", "edges/half_edges"),
    ),
    "wrong partner": (("edges/half_edges", (3, 1), 3), ("V402", "edges/half_edges")),
    "order": (
        ("edges/half_edges", slice(0, 2), [[NONE, 2], [0, NONE]]),
        ("V403", "edges/half_edges"),
    ),
    "component": (("components/edge_start", 1, 6), ("V403", "edges/half_edges")),
    "pair of one": (("edges/flags", 0, 0), ("V404", "edges/flags")),
    "border of two": (("edges/flags", 3, 1), ("V404", "edges/flags")),
    "split of two": (("edges/flags", 5, 2), ("V404", "edges/flags")),
    "planar border": (("edges/flags", 0, 5), ("V405", "edges/flags")),
    "planar bend": (("edges/flags", 5, 4), ("V405", "edges/flags")),
    "off plane": (("planes/d", 0, -8.01), ("V406", "planes/plane_of_face")),
    "d nan": (("planes/d", 0, np.nan), ("V406", "planes/plane_of_face")),
    "against": (("planes/plane_of_face", 2, 0), ("V407", "planes/plane_of_face")),
    "stray": (("planes/face", 0, 5), ("V407", "planes/face")),
    "closed": (("components/flags", 0, 1), ("V408", "components/flags")),
    "not closed": (("components/flags", 1, 0), ("V408", "components/flags")),
    "grouping": (("components/face_start", 1, 3), ("V409", "objects")),
    "plane unused": (("planes/plane_of_face", 5, 3), ("V410", "planes/d")),
    "plane order": (
        ("planes/plane_of_face", slice(2, 4), [2, 1]),
        ("V410", "planes/plane_of_face"),
    ),
    "plane of a neighbour": (("planes/plane_of_face", 2, 0), ("V410", "planes/plane_of_face")),
    "no faces": (("components/face_start", 1, 0), ("V409", "components")),
    "edge not in a tree": (("cones/edge", 0, 6), ("V411", "cones/edge")),
    "edge of no pair in a tree": (("hextree/edge", 2, 3), ("V411", "hextree/edge")),
    "tree of another object": (("index/object", 0, 0), ("V411", "hextree/edge")),
    "tree without edges": (("index/pair_start", 1, 0), ("V301", "index/pair_start")),
    "frame nan": (("index/frame", (0, 1), np.nan), ("V411", "index/frame")),
    "frame without radius": (("index/frame", (0, 3), 0.0), ("V411", "index/frame")),
    "frame elsewhere": (("index/frame", (0, 0), 4.0), ("V411", "index/frame")),
    "work": (("hextree/work", (0, 1), np.inf), ("V411", "hextree/work")),
    "work below zero": (("cones/work", (0, 0), -1.0), ("V411", "cones/work")),
    "box": (("hextree/blocks", (0, 0, 0), 500), ("V412", "hextree/blocks")),
    "object twice": (("scene/object", 0, 1), ("V413", "scene/object")),
    "face twice": (("scene/face", 0, 1), ("V413", "scene/face")),
    "empty cluster": (("scene/cluster_start", 1, 0), ("V413", "scene/cluster_start")),
    "cluster of two objects": (("scene/cluster_start", 1, 3), ("V413", "scene/face")),
    "object box": (("scene/object_boxes", (1, 2), 0.5), ("V413", "scene/object_boxes")),
    "object box nan": (("scene/object_boxes", (0, 3), np.nan), ("V413", "scene/object_boxes")),
    "object node": (("scene/object_nodes", (0, 3), 5.5), ("V413", "scene/object_nodes")),
    "cluster node": (("scene/cluster_nodes", (0, 0), 0.5), ("V413", "scene/cluster_nodes")),
    "cluster node too wide": (
        ("scene/cluster_nodes", (0, 5), 9.0),
        ("V413", "scene/cluster_nodes"),
    ),
    "spec offsets": (("lights/spec_start", 1, 99), ("V301", "lights/spec_start")),
    "direction": (("lights/light", (0, 2), 0.9), ("V414", "lights/light")),
    "light nan": (("lights/light", (1, 0), np.nan), ("V414", "lights/light")),
    "light neither": (("lights/light", (1, 3), 0.5), ("V414", "lights/light")),
    "axis too short": (("lights/frame", (0, 0, 0), 0.999), ("V414", "lights/frame")),
    "axis nan": (("lights/frame", (0, 1, 2), np.nan), ("V414", "lights/frame")),
    "axis towards the light": (("lights/frame", (0, 2), [0, 0, 1]), ("V414", "lights/frame")),
    "axes of a lamp": (("lights/frame", 1, np.eye(3)[[1, 2, 0]]), ("V414", "lights/frame")),
    "facts": (("lights/facts", (0, 2), -1.0), ("V414", "lights/facts")),
    "facts nan": (("lights/facts", (1, 0), np.nan), ("V414", "lights/facts")),
    "facts inf": (("lights/facts", (1, 4), np.inf), ("V414", "lights/facts")),
    "caster without segments": (
        ("clamp/segment_start", (0, 1), 0),
        ("V414", "clamp/segment_start"),
    ),
    "segments from 1": (("clamp/segment_start", (1, 0), 1), ("V414", "clamp/segment_start")),
    "segments fall": (("clamp/segment_start", (0, 1), 9), ("V414", "clamp/segment_start")),
    "segments left over": (("clamp/segment_start", (0, 2), 2), ("V414", "clamp/segment_start")),
    "segments of a neighbour": (
        ("lights/segment_start", 1, 2),
        ("V414", "clamp/segment_start"),
    ),
    "far before near": (("clamp/depth", (0, 1), -4.2), ("V414", "clamp/depth")),
    "near nan": (("clamp/depth", (2, 0), np.nan), ("V414", "clamp/depth")),
    "near infinite": (("clamp/depth", (2, 0), -np.inf), ("V414", "clamp/depth")),
    "far nan": (("clamp/depth", (5, 1), np.nan), ("V414", "clamp/depth")),
    "segments that overlap": (("clamp/depth", (4, 0), 1.05), ("V414", "clamp/depth")),
    "before the lamp": (("clamp/depth", (3, 0), -0.1), ("V414", "clamp/slope")),
    "slope of a lamp": (("clamp/slope", (3, 1), 1), ("V414", "clamp/slope")),
    "count order": (("repair/count_object", 0, 1), ("V501", "repair/count_object")),
    "count zero": (("repair/count", 0, 0), ("V501", "repair/count")),
    "finding order": (("repair/finding_source_face", 1, 9), ("V501", "repair/finding_object")),
    "flipped order": (("repair/flipped_faces", 0, 5), ("V501", "repair/flipped_faces")),
    "too many faces": (("repair/source_triangles", 0, 1), ("V501", "repair/source_triangles")),
    "count code": (("repair/count_code", 0, 999), ("V502", "repair/count_code")),
    "finding code": (("repair/finding_code", 2, 999), ("V502", "repair/finding_code")),
}


@pytest.mark.parametrize("name", BUGS)
def test_broken_invariants_are_named(name: str, copy: Path) -> None:
    (path, index, value), expected = BUGS[name]
    with h5py.File(copy, locking=False) as file:
        array = file[path][...]
    array[index] = value
    rewrite(copy, **{path: array})
    problems = verify(copy)
    assert expected in [(p.code, p.where) for p in problems], [str(p) for p in problems]
    assert not {p.code for p in problems} & {"V201", "V202"}
    assert all("\n" not in str(p) for p in problems)
    # A reader gives tables or one line, never a traceback.
    with contextlib.suppress(CacheError), open_cache(copy) as cache:
        cache.prepared()


@pytest.fixture(scope="module")
def spheres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spheres") / "spheres.svp.h5"
    write_cache(two_spheres(), path)
    assert verify(path) == []
    return path


def _swap(array: np.ndarray, i: int, j: int) -> None:
    array[[i, j]] = array[[j, i]]


def _narrow(array: np.ndarray, block: int, number: int, n_units: int) -> None:
    array[block, number, 0] -= n_units


# (dataset, change), then the one problem that must be reported. The large tree has
# 33 blocks (1, 4, 28), the small one 8 (1, 7); edges 1752 and on are the small one's.
TREE_BUGS: dict[str, tuple[str, Callable[[np.ndarray], None], tuple[str, str]]] = {
    "an edge twice": (
        "hextree/edge",
        lambda a: a.__setitem__(5, a[6]),
        ("V411", "hextree/edge"),
    ),
    "edges of two trees swapped": (
        "cones/edge",
        lambda a: _swap(a, 10, 1800),
        ("V411", "cones/edge"),
    ),
    "edges of one tree swapped": (
        "hextree/edge",
        lambda a: _swap(a, 0, 1751),
        ("V412", "hextree/blocks"),
    ),
    "objects swapped": ("index/object", lambda a: _swap(a, 0, 1), ("V411", "index/object")),
    "a tree that begins late": (
        "index/pair_start",
        lambda a: a.__setitem__(1, a[1] + 1),
        ("V411", "cones/edge"),
    ),
    "too few blocks": (
        "index/pair_start",
        lambda a: a.__setitem__(1, 900),
        ("V411", "index/pair_start"),
    ),
    "a tree without edges": (
        "index/pair_start",
        lambda a: a.__setitem__(1, 0),
        ("V411", "index/pair_start"),
    ),
    "frames swapped": ("index/frame", lambda a: _swap(a, 0, 1), ("V411", "index/frame")),
    "a frame too large": (
        "index/frame",
        lambda a: a.__setitem__((1, 3), 2.0 * a[1, 3]),
        ("V412", "hextree/blocks"),
    ),
    "a frame moved": (
        "index/frame",
        lambda a: a.__setitem__((0, slice(2, None)), a[0, 2:] + 1.0),
        ("V412", "hextree/blocks"),
    ),
    **{
        f"a box too narrow: block {block}, number {number}": (
            "hextree/blocks",
            lambda a, block=block, number=number: _narrow(a, block, number, 3),
            ("V412", "hextree/blocks"),
        )
        for block, number in ((0, 4), (2, 7), (20, 5), (33, 6), (40, 7))
    },
    "a box moved": (
        "hextree/blocks",
        lambda a: a.__setitem__((32, 0, 1), a[32, 0, 1] + 3),
        ("V412", "hextree/blocks"),
    ),
    "a cluster of nine": (
        "scene/cluster_start",
        lambda a: a.__setitem__(5, a[5] + 1),
        ("V413", "scene/cluster_start"),
    ),
    "faces of two clusters swapped": (
        "scene/face",
        lambda a: _swap(a, 0, len(a) - 1),
        ("V413", "scene/cluster_nodes"),
    ),
    **{
        f"a node too small: {node}": (
            "scene/cluster_nodes",
            lambda a, node=node, side=side: a.__setitem__((node, side), a[node].mean()),
            ("V413", "scene/cluster_nodes"),
        )
        # The last nodes are the root and the level below it.
        for node, side in ((0, 0), (11, 4), (-3, 2), (-2, 3), (-1, 5))
    },
    "a caster without segments": (
        "clamp/segment_start",
        lambda a: a.__setitem__((1, 2), a[1, 1]),
        ("V414", "clamp/segment_start"),
    ),
}


@pytest.mark.parametrize("name", TREE_BUGS)
def test_a_wrong_tree_is_named_and_nothing_else(name: str, spheres: Path, tmp_path: Path) -> None:
    path, change, expected = TREE_BUGS[name]
    copy = Path(shutil.copy(spheres, tmp_path))
    with h5py.File(copy, locking=False) as file:
        array = file[path][...]
    change(array)
    rewrite(copy, **{path: array})
    problems = verify(copy)
    assert expected in [(p.code, p.where) for p in problems], [str(p) for p in problems]
    assert {p.code for p in problems} == {expected[0]}


def _read(path: Path, *names: str) -> list[np.ndarray]:
    with h5py.File(path, locking=False) as file:
        return [file[name][...] for name in names]


@pytest.mark.parametrize("name", ["scene/object_nodes", "scene/cluster_nodes"])
def test_a_missing_or_additional_node_is_named(name: str, spheres: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(spheres, tmp_path))
    (nodes,) = _read(copy, name)
    for wrong in (nodes[:-1], np.vstack((nodes, nodes[-1:])), nodes[:0]):
        rewrite(copy, **{name: wrong})
        (problem,) = verify(copy)
        assert (problem.code, problem.where) == ("V413", name)
        assert problem.message == f"expected {len(nodes)} nodes, got {len(wrong)}"


def test_nine_segments_of_a_caster_are_named(copy: Path) -> None:
    names = ("lights/segment_start", "clamp/segment_start", "clamp/depth", "clamp/slope")
    light_start, start, depth, slope = _read(copy, *names)
    more = np.column_stack((np.arange(1.0, 8.0), np.arange(1.5, 8.0)))
    for n, codes in ((6, []), (7, ["V414"])):  # after two that it has
        wider = dict(
            zip(
                names,
                (
                    light_start + np.array([0, n, n], np.uint32),
                    start + np.array([[0, n, n], [0, 0, 0]], np.uint32),
                    np.insert(depth, [2] * n, more[:n].astype(np.float32), axis=0),
                    np.insert(slope, [2] * n, 0, axis=0),
                ),
                strict=True,
            )
        )
        rewrite(copy, **wider)
        assert [p.code for p in verify(copy)] == codes


def test_random_values_in_trees_raise_nothing(spheres: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    copy = Path(shutil.copy(spheres, tmp_path))
    groups = ("index/", "cones/", "hextree/", "scene/", "lights/", "clamp/")
    names = [s.path for s in schema.DATASETS if s.path.startswith(groups)]
    names += ["edges/half_edges", "edges/flags", "planes/face"]
    with h5py.File(copy, locking=False) as file:
        original = {name: file[name][...] for name in names}
    for _ in range(90):
        name = names[rng.integers(len(names))]
        array = original[name].copy()
        raw = array.view(np.uint8).reshape(-1)
        raw[rng.integers(len(raw), size=3)] ^= rng.integers(1, 256, size=3, dtype=np.uint8)
        rewrite(copy, **{name: array})
        assert found_in(copy) != ["CacheError"]
        rewrite(copy, **{name: original[name]})
    assert verify(copy) == []


def test_random_values_with_right_digests_raise_nothing(copy: Path) -> None:
    rng = np.random.default_rng(3)
    with h5py.File(copy, locking=False) as file:
        original = {s.path: file[s.path][...] for s in schema.DATASETS}
    for _ in range(120):
        path = schema.DATASETS[rng.integers(len(schema.DATASETS))].path
        array = original[path].copy()
        raw = array.view(np.uint8).reshape(-1)
        raw[rng.integers(len(raw))] ^= rng.integers(1, 256, dtype=np.uint8)
        rewrite(copy, **{path: array})
        found_in(copy)
        with contextlib.suppress(CacheError), open_cache(copy) as cache:
            cache.prepared()
        rewrite(copy, **{path: original[path]})
    assert verify(copy) == []


def test_every_check_has_a_test_and_an_explanation() -> None:
    tested = {code for _, (code, _) in FORGERIES.values()} | {c for _, (c, _) in BUGS.values()}
    # V104 takes HDF5 structures that are damaged under a right checksum.
    assert set(CHECKS) - tested == {"V104", "V201"}
    assert all(c.summary.endswith(".") and c.consequence for c in CHECKS.values())


def test_unchecked_reading_is_possible(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        file["repair/source_triangles"][...] = [7, 8]
    with open_cache(copy, check_digests=False) as cache:
        assert cache.repair.source_triangles.tolist() == [7, 8]


def make_split() -> Prepared:
    """Return three triangles on one edge: a consistent pair and one left over."""
    sample = strip_and_tetrahedron()
    mesh = sample.mesh
    positions = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], np.float32)
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.uint32)
    rows = np.array(
        [
            [0, 1, 0, 1],
            [0, 2, 0xFFFFFFFF, 0],
            [0, 3, 1, 0xFFFFFFFF],
            [1, 2, 0, 0xFFFFFFFF],
            [1, 3, 0xFFFFFFFF, 1],
            [0, 1, 2, 0xFFFFFFFF],
            [0, 4, 0xFFFFFFFF, 2],
            [1, 4, 2, 0xFFFFFFFF],
        ],
        np.uint32,
    )
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    normal = np.cross(b - a, c - a)
    planes = np.column_stack([normal, -(normal * a).sum(1)])
    empty = np.zeros(0, np.uint32)
    fan = replace(
        mesh,
        positions=positions,
        faces=faces,
        object_vertex_start=np.array([0, 5]),
        object_face_start=np.array([0, 3]),
        source_face=np.arange(3, dtype=np.uint32),
    )
    return replace(
        sample,
        object_names=("fan",),
        object_source=np.zeros(1, np.uint32),
        labels=Labels.none(1, 3),
        mesh=fan,
        components=replace(
            sample.components,
            object_start=np.array([0, 2]),
            face_start=np.array([0, 2, 3]),
            edge_start=np.array([0, 5, 8]),
            flags=np.zeros(2, np.uint8),
        ),
        planes=replace(sample.planes, planes=planes, plane_of_face=np.arange(3, dtype=np.uint32)),
        edges=replace(sample.edges, rows=rows, flags=np.array([2, 1, 1, 1, 1, 2, 1, 1], np.uint8)),
        index=no_trees(),
        scene=one_cluster_each(fan),
        clamp=no_lights(2),
        repair=replace(
            sample.repair,
            defect_counts=sample.repair.defect_counts[:1] * np.uint32(0),
            source_triangles=np.array([3], np.uint32),
            source_digest=np.array([[7, 8]], np.uint64),
            face_findings=replace(
                sample.repair.face_findings,
                code=np.zeros(0, np.uint16),
                object_index=empty,
                source_face=empty,
            ),
            flipped_faces=empty,
        ),
    )


def test_an_edge_of_three_faces_is_sound(tmp_path: Path) -> None:
    path = tmp_path / "fan.h5"
    write_cache(make_split(), path)
    assert verify(path) == []
    with open_cache(path) as cache:
        assert_same(cache.prepared(), make_split())

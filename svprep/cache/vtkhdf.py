"""The group ``VTKHDF``: the mesh as ParaView, PyVista and VTK read it, without a copy.

    VTKHDF/Points                    is  mesh/positions          (hard links:
    VTKHDF/Polygons/Connectivity     is  mesh/face_corners        the same bytes)
    VTKHDF/CellData/plane ...        is  planes/plane_of_face ...
    VTKHDF/Polygons/Offsets          follows from the tables, packed
    VTKHDF/CellData/object, component

Nothing in svprep reads it. All of it follows from the datasets, so it has no digest:
`check_vtk` computes it again and compares.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from svprep.cache.checks import Problem
from svprep.cache.contents import Contents

GROUP: Final = "VTKHDF"
VERSION: Final = (2, 0)
"""Of the layout: the first in which all these arrays have their present names."""
TYPE: Final = b"PolyData"

_PACKED_LENGTH: Final = 1 << 12
"""Arrays of so many entries are packed; shorter ones would grow by it."""
_CHUNK: Final = 1 << 16

Raw = NDArray[Any]


@dataclass(frozen=True, slots=True)
class VtkItem:
    """One dataset or group below `GROUP`."""

    path: str
    """Below `GROUP`."""
    dtype: str
    shape: str
    meaning: str
    link: str = ""
    """What it is a hard link to, from the root; "" if it is a dataset of its own."""


VTK_ITEMS: Final[tuple[VtkItem, ...]] = (
    VtkItem("NumberOfPoints", "<i8", "(1,)", "n_vertices."),
    VtkItem("Points", "<f4", "(n_vertices, 3)", "In the cache frame.", "mesh/positions"),
    VtkItem("Polygons/NumberOfConnectivityIds", "<i8", "(1,)", "3 * n_faces."),
    VtkItem("Polygons/NumberOfCells", "<i8", "(1,)", "n_faces."),
    VtkItem("Polygons/Offsets", "<i4", "(n_faces + 1,)", "0, 3, 6, ..."),
    VtkItem("Polygons/Connectivity", "<i4", "(3 * n_faces,)", "Corners.", "mesh/face_corners"),
    VtkItem("Vertices/NumberOfConnectivityIds", "<i8", "(1,)", "0."),
    VtkItem("Vertices/NumberOfCells", "<i8", "(1,)", "0."),
    VtkItem("Vertices/Offsets", "<i4", "(1,)", "0."),
    VtkItem("Vertices/Connectivity", "<i4", "(0,)", "Nothing."),
    VtkItem("Lines", "", "", "None either.", f"{GROUP}/Vertices"),
    VtkItem("Strips", "", "", "None either.", f"{GROUP}/Vertices"),
    VtkItem("CellData/object", "<i4", "(n_faces,)", "Object of each face."),
    VtkItem("CellData/component", "<i4", "(n_faces,)", "Component of each face."),
    VtkItem("CellData/plane", "<u4", "(n_faces,)", "Plane record.", "planes/plane_of_face"),
    VtkItem("CellData/surface", "|u1", "(n_faces,)", "What each face is.", "mesh/surface"),
    VtkItem("CellData/source_face", "<u4", "(n_faces,)", "Source polygon.", "mesh/source_face"),
    VtkItem("FieldData/grid_origin_m", "<f8", "(3,)", "Source position = this + point."),
)
NEEDS: Final = ("objects/face_start", "components/face_start")
"""Datasets that the rest is computed from, beside the lengths of two more."""
_COUNTED: Final = ("mesh/positions", "mesh/face_corners")


def derived(
    n_points: int, n_corners: int, starts: Mapping[str, Raw], origin_m: Raw
) -> dict[str, Raw]:
    """Return the arrays that `GROUP` holds besides links, by path. O(n_faces).

    Without those whose offsets do not fit the faces.
    """
    n_faces = n_corners // 3
    one = {
        "NumberOfPoints": n_points,
        "Polygons/NumberOfConnectivityIds": n_corners,
        "Polygons/NumberOfCells": n_faces,
        "Vertices/NumberOfConnectivityIds": 0,
        "Vertices/NumberOfCells": 0,
    }
    own = {path: np.array([n], "<i8") for path, n in one.items()}
    own["Polygons/Offsets"] = np.arange(0, n_corners + 1, 3, dtype="<i4")
    own["Vertices/Offsets"] = np.zeros(1, "<i4")
    own["Vertices/Connectivity"] = np.zeros(0, "<i4")
    for name in ("object", "component"):
        start = starts[f"{name}s/face_start"].astype(np.int64)
        size = np.diff(start)
        if start[0] == 0 and start[-1] == n_faces and (size >= 0).all():
            own[f"CellData/{name}"] = np.repeat(np.arange(len(size), dtype="<i4"), size)
    own["FieldData/grid_origin_m"] = np.asarray(origin_m, "<f8")
    return own


def write_vtk(file: h5py.File, contents: Contents, origin_m: Raw) -> None:
    """Write the group into a file that holds all datasets. About 10 ms per million faces."""
    group = file.create_group(GROUP)
    group.attrs.create("Version", np.array(VERSION, "<i8"))
    group.attrs.create("Type", np.array(TYPE), dtype=h5py.string_dtype("ascii", len(TYPE)))
    starts = {path: contents.whole(path) for path in NEEDS}
    sizes = contents.shape("mesh/positions")[0], contents.shape("mesh/face_corners")[0]
    own = derived(*sizes, starts, origin_m)
    for item in VTK_ITEMS:
        if item.link:
            group[item.path] = file[item.link]
            continue
        array = own[item.path]
        options: dict[str, Any] = {}
        if chunks := _chunks(array):
            options = {"chunks": chunks, "shuffle": True, "compression": "gzip"}
            options["compression_opts"] = 1
        group.create_dataset(item.path, data=array, track_times=False, **options)


def _chunks(array: Raw) -> tuple[int] | None:
    """Return the chunks that an array is packed in, None for one that lies in one piece."""
    return (min(_CHUNK, len(array)),) if len(array) >= _PACKED_LENGTH else None


def check_vtk(
    file: h5py.File, arrays: Mapping[str, Raw], origin_m: Raw | None
) -> Iterator[Problem]:
    """Yield what is wrong with the group.

    Parameters
    ----------
    file : h5py.File
    arrays
        The datasets that are whole. Without `NEEDS` only links are looked at.
    origin_m
        The attribute ``grid_origin_m``, or None if that is damaged.

    Raises
    ------
    OSError, RuntimeError, LookupError, ValueError and what else h5py raises
        HDF5 cannot read the group.
    """
    if not isinstance(file.get(GROUP, getlink=True), h5py.HardLink):
        yield Problem("V101", GROUP, "it is missing")
        return
    group = file[GROUP]
    said = [np.asarray(group.attrs.get(name)).tolist() for name in ("Version", "Type")]
    if said != [list(VERSION), TYPE] or len(group.attrs) != 2:
        yield Problem("V106", GROUP, f"expected Type {TYPE.decode()} of version {VERSION}")
    yield from _unknown(group)
    has_all = all(path in arrays for path in (*NEEDS, *_COUNTED))
    own = {}
    if has_all and origin_m is not None:
        n_points, n_corners = (len(arrays[path]) for path in _COUNTED)
        own = derived(n_points, n_corners, arrays, origin_m)
    for item in VTK_ITEMS:
        where = f"{GROUP}/{item.path}"
        if not _is_inside(file, where):
            yield Problem("V101", where, "it is missing, or a link out of the group")
        elif item.link:
            if item.link in file and file[where] != file[item.link]:
                yield Problem("V106", where, f'it is not a hard link to "{item.link}"')
        elif item.path in own and (wrong := _difference(file[where], own[item.path])):
            yield Problem("V106", where, wrong)


def _is_inside(file: h5py.Group, path: str) -> bool:
    """Whether hard links alone lead to `path`: no other file is looked at."""
    parts = path.split("/")
    names = ["/".join(parts[: n + 1]) for n in range(len(parts))]
    return all(isinstance(file.get(name, getlink=True), h5py.HardLink) for name in names)


def _unknown(group: h5py.Group) -> Iterator[Problem]:
    """Yield what no one declared."""
    known = {item.path for item in VTK_ITEMS}
    folders = {path.split("/")[0] for path in known if "/" in path}
    for folder in ("", *sorted(folders)):
        if folder and not (_is_inside(group, folder) and isinstance(group[folder], h5py.Group)):
            continue  # missing, or of another kind: reported with its members
        for name in group[folder] if folder else group:
            path = f"{folder}/{name}".lstrip("/")
            if path not in known and path not in folders:
                yield Problem("V103", f"{GROUP}/{path}", "it is not part of the schema")


def _difference(dataset: object, expected: Raw) -> str:
    """Return how a dataset differs from what follows from the tables, "" if it does not."""
    if not isinstance(dataset, h5py.Dataset):
        return "expected a dataset"
    plist = dataset.id.get_create_plist()
    filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
    chunks = _chunks(expected)
    plain = {h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE} if chunks else set()
    form = (dataset.shape, dataset.dtype, dataset.chunks, filters, plist.get_external_count())
    if form != (expected.shape, expected.dtype, chunks, plain, 0):
        return f"expected {expected.dtype.str} {expected.shape}, as svprep writes it"
    if not np.array_equal(dataset[...], expected):
        return "it does not follow from the tables: its bytes are not those that were written"
    return ""

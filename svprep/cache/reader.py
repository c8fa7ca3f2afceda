"""Reading a cache: checked on opening, each table read when first asked for.

    with open_cache("city.svp.h5") as cache:
        print(cache.n_faces, cache.object_names[0])
        normals = cache.planes.planes[:, :3]

Arrays are read into memory, not mapped: their digests are checked on the way,
which touches every byte anyway, and a mapped file that something truncates in
place would kill the process without a word. They stay valid after the cache is
closed. A cache that is replaced while it is open goes on giving the old content.
"""

from __future__ import annotations

import json
import os
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svprep.cache import codec
from svprep.cache.schema import (
    ATTRIBUTE_OF_NAME,
    ATTRIBUTES,
    DATASETS,
    DIGESTS_PATH,
    SPEC_OF_PATH,
    DatasetSpec,
    item_digest,
    shape_problem,
)
from svprep.cache.storage import (
    attribute_value,
    check_root,
    damage_named,
    frozen_view,
    open_hdf5,
    read_digest_table,
    read_raw,
    stored_dataset,
)
from svprep.errors import CacheError
from svprep.model import (
    U32,
    ClampTable,
    Components,
    EdgeTable,
    Grid,
    Labels,
    Mesh,
    Place,
    PlaneTable,
    Prepared,
    RepairRecord,
    SceneTree,
    SilhouetteIndex,
    SourceFile,
)
from svprep.sun import Site

SHARED = ("mesh/positions", "mesh/face_corners")
"""Datasets that several tables are decoded from: kept once read."""


class Cache:
    """An open cache file. Use `open_cache`; close it, or use it in a ``with``.

    Every table is read when first asked for and kept. All arrays are read-only.
    """

    def __init__(self, path: Path, *, check_digests: bool = True) -> None:
        self._path = path
        self._kept: dict[str, NDArray[np.generic]] = {}
        self._sizes: dict[str, int] = {}
        self._file = open_hdf5(path)
        try:
            self._bytes = {spec.path: self._check_declared(spec) for spec in DATASETS}
            self._digest_of = self._read_digests() if check_digests else {}
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Cache:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file. Tables that have been read stay usable."""
        self._file.close()

    def __repr__(self) -> str:
        return f"<Cache {str(self._path)!r}: {self.n_objects} objects, {self.n_faces} faces>"

    @property
    def path(self) -> Path:
        """The file, as it was named."""
        return self._path

    @property
    def n_objects(self) -> int:
        """Objects."""
        return self._sizes["n_objects"]

    @property
    def n_vertices(self) -> int:
        """Vertices."""
        return self._sizes["n_vertices"]

    @property
    def n_faces(self) -> int:
        """Faces."""
        return self._sizes["n_faces"]

    @property
    def n_components(self) -> int:
        """Connected components."""
        return self._sizes["n_components"]

    @property
    def n_planes(self) -> int:
        """Plane records."""
        return self._sizes["n_planes"]

    @property
    def n_edges(self) -> int:
        """Edge records."""
        return self._sizes["n_edges"]

    def dataset_sizes(self) -> dict[str, int]:
        """Return the bytes of each dataset in the file."""
        return dict(self._bytes)

    @cached_property
    def producer_version(self) -> str:
        """The svprep that wrote the file."""
        return self._text("producer_version")

    @cached_property
    def tables_by(self) -> str:
        """SHA-256 of the code that made the tables of objects."""
        return self._text("tables_by")

    @cached_property
    def content_digest(self) -> str:
        """Equal for two builds from the same sources and configuration."""
        return self._text("content_digest")

    @cached_property
    def crs(self) -> str:
        """Coordinate reference system, ``""`` when unknown."""
        return self._text("crs")

    @cached_property
    def config(self) -> dict[str, object]:
        """What the build was asked for."""
        value = self._json("config", dict)
        assert isinstance(value, dict)
        return value

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """One line each on what was left out or converted."""
        value = self._json("notes", list)
        assert isinstance(value, list)
        return tuple(map(str, value))

    @cached_property
    def sources(self) -> tuple[SourceFile, ...]:
        """The input files, as they were read."""
        paths, sources = self._json("source_paths", list), self._json("sources", list)
        with self._damage_named('the attribute "sources"'):
            return codec.decode_sources(paths, sources)

    @cached_property
    def grid(self) -> Grid:
        """The quantisation grid."""
        step = float(self._numbers("grid_step_m"))
        return Grid(step_m=step, origin_m=codec.frozen(self._numbers("grid_origin_m")))

    @cached_property
    def site(self) -> Site:
        """Where the model stands, for the sun's azimuth."""
        x_m, y_m, _ = self.grid.origin_m.tolist()
        return Site.of(self.place, x_m, y_m)

    @cached_property
    def object_names(self) -> tuple[str, ...]:
        """``(n_objects,)``."""
        with self._damage_named("the table of object names"):
            return codec.decode_names(self.raw)

    @cached_property
    def object_source(self) -> U32:
        """``(n_objects,)``: index into `sources`."""
        return self.raw("objects/source")

    @cached_property
    def labels(self) -> Labels:
        """What the sources say of objects and faces: types, parents, surfaces."""
        types, surfaces = self._json("object_types", list), self._json("surface_names", list)
        with self._damage_named("the labels of objects and faces"):
            return codec.decode_labels(self.raw, types, surfaces)

    @cached_property
    def place(self) -> Place:
        """Where on Earth the model stands."""
        stored = self._json("place", dict)
        with self._damage_named('the attribute "place"'):
            return codec.decode_place(self.crs, stored)

    @cached_property
    def mesh(self) -> Mesh:
        """Positions and faces, grouped by object."""
        grid = self.grid
        with self._damage_named("the mesh"):
            return codec.decode_mesh(self.raw, grid)

    @cached_property
    def components(self) -> Components:
        """Connected components."""
        with self._damage_named("the table of components"):
            return codec.decode_components(self.raw)

    @cached_property
    def planes(self) -> PlaneTable:
        """Plane records."""
        tolerance = float(self._numbers("planar_tolerance_m"))
        with self._damage_named("the table of planes"):
            return codec.decode_planes(self.raw, tolerance)

    @cached_property
    def edges(self) -> EdgeTable:
        """Edge records."""
        with self._damage_named("the table of edges"):
            return codec.decode_edges(self.raw)

    @cached_property
    def index(self) -> SilhouetteIndex:
        """Silhouette trees."""
        with self._damage_named("the silhouette trees"):
            return codec.decode_index(self.raw)

    @cached_property
    def scene(self) -> SceneTree:
        """Trees over objects and over clusters of faces."""
        with self._damage_named("the scene trees"):
            return codec.decode_scene(self.raw)

    @property
    def n_lights(self) -> int:
        """Lights whose shadows are clamped."""
        return self._sizes["n_lights"]

    @cached_property
    def clamp(self) -> ClampTable:
        """Lights, and the segments of every caster for each."""
        with self._damage_named("the clamped segments"):
            return codec.decode_clamp(self.raw)

    @cached_property
    def repair(self) -> RepairRecord:
        """What weld and repair decided."""
        with self._damage_named("the repair record"):
            return codec.decode_repair(self.raw, self.n_objects)

    def prepared(self) -> Prepared:
        """Return everything, as `pipeline.prepare` returned it."""
        return Prepared(
            sources=self.sources,
            object_names=self.object_names,
            object_source=self.object_source,
            labels=self.labels,
            place=self.place,
            mesh=self.mesh,
            components=self.components,
            planes=self.planes,
            edges=self.edges,
            index=self.index,
            scene=self.scene,
            clamp=self.clamp,
            repair=self.repair,
            config=self.config,
            notes=self.notes,
        )

    def raw(self, path: str) -> NDArray[Any]:
        """Return a dataset, its digest checked, read-only; indices are unsigned.

        Raises
        ------
        CacheError
            The dataset is damaged.
        """
        if path in self._kept:
            return self._kept[path]
        if not self._file:
            raise CacheError(f'{self._path} was closed before "{path}" was read. Open it again')
        with self._damage_named(f'the dataset "{path}"'):
            array = read_raw(self._file[path])
            expected = self._digest_of.get(path)
            if expected and item_digest(path, SPEC_OF_PATH[path].dtype, array) != expected:
                raise ValueError("its bytes are not those that were written")
            array = frozen_view(array, SPEC_OF_PATH[path])
        if path in SHARED:
            self._kept[path] = array
        return array

    def attributes(self) -> dict[str, bytes | NDArray[np.generic]]:
        """Return every root attribute but the two digests, as it is stored."""
        digests = ("content_digest", "root_digest")
        return {
            spec.name: self._value(spec.name) for spec in ATTRIBUTES if spec.name not in digests
        }

    def _damage_named(self, what: str) -> AbstractContextManager[None]:
        return damage_named(self._path, what, self._file)

    def _check_declared(self, spec: DatasetSpec) -> int:
        with self._damage_named(f'the dataset "{spec.path}"'):
            dataset = stored_dataset(self._file, spec.path)
            if problem := shape_problem(spec, dataset.dtype, dataset.shape, self._sizes):
                raise ValueError(problem)
            return int(dataset.nbytes)

    def _read_digests(self) -> dict[str, str]:
        with self._damage_named(f'the dataset "{DIGESTS_PATH}"'):
            table = read_digest_table(self._file)
            if [path for path, _ in table] != [spec.path for spec in DATASETS]:
                raise ValueError("it does not list the declared datasets in their order")
        values = {spec.name: self._value(spec.name) for spec in ATTRIBUTES}
        with self._damage_named("the digest table or an attribute"):
            check_root(values, table)
        return dict(table)

    def _value(self, name: str) -> bytes | NDArray[np.generic]:
        with self._damage_named(f'the attribute "{name}"'):
            return attribute_value(self._file, ATTRIBUTE_OF_NAME[name])

    def _numbers(self, name: str) -> NDArray[np.float64]:
        return np.array(self._value(name), np.float64)

    def _text(self, name: str) -> str:
        with self._damage_named(f'the attribute "{name}"'):
            return bytes(self._value(name)).decode()

    def _json(self, name: str, kind: type) -> object:
        with self._damage_named(f'the attribute "{name}"'):
            value = json.loads(self._text(name))
            if not isinstance(value, kind):
                raise ValueError(f"expected a JSON {kind.__name__}, got {type(value).__name__}")
            return value


def open_cache(path: str | os.PathLike[str], *, check_digests: bool = True) -> Cache:
    """Open a cache for reading.

    Parameters
    ----------
    path : path-like
    check_digests : bool
        Check each dataset's SHA-256 when it is first read (0.6 s per GB), so
        that no shadow is drawn from damaged arrays.

    Raises
    ------
    CacheError
        There is no such file, it is not a cache, of another schema, truncated
        or damaged. Damage inside a dataset is found when it is first read.
    """
    return Cache(Path(path), check_digests=check_digests)

"""The query: a light in, the silhouette out, by any method."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal, get_args
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from svprep.errors import InputError
from svprep.facing import checked_light
from svprep.light import Light
from svprep.model import F32, F64, I8, I64, Prepared
from svprep.silhouette.cost import is_tree_cheaper, tree_costs
from svprep.silhouette.result import Silhouette
from svprep.silhouette.scan import Plan, Run, Scratch, make_plan
from svprep.silhouette.tables import SearchTables, contradiction, read_only
from svprep.silhouette.trees import TreeTables, common_floor, tree_tables
from svprep.silhouette.walks import brute, edge_buffer, elimination

if TYPE_CHECKING:
    from svprep.cache.reader import Cache

Method = Literal["auto", "brute", "edge_buffer", "elimination", "flat", "cones", "hextree"]
METHODS: Final[tuple[Method, ...]] = get_args(Method)
Volume = Literal["auto", "closed", "robust"]
VOLUMES: Final[tuple[Volume, ...]] = get_args(Volume)

_FORCED_FLOOR = {"closed": 0, "robust": -1}
"""`SearchTables.floor` of every plane record where a volume is forced."""

_WALKS = {"brute": brute, "edge_buffer": edge_buffer, "elimination": elimination}
"""Methods that use no index and remove nothing in advance."""


def silhouette(
    cache: Cache | Prepared,
    light: ArrayLike | Light,
    method: Method = "auto",
    *,
    volume: Volume = "auto",
    objects: ArrayLike | None = None,
) -> Silhouette:
    """Return the silhouette for a light: which edges, in which direction, how often.

    Every method gives the same rows; they differ in what they look at.

    ``brute``
        every edge record.
    ``edge_buffer``
        every side of every face, added up in a buffer (Buchanan and Sousa 2000).
    ``elimination``
        the same, in a list from which agreeing edges vanish (Steiner 2006).
    ``flat``
        every record that is not planar.
    ``cones``
        a hierarchy of spheres with normal cones (Sander et al. 2000), for objects
        large enough to have one; `flat` for the others.
    ``hextree``
        a hierarchy of boxes of dual points (Hertzmann and Zorin 2000), likewise.
    ``auto``
        per object the dual boxes or the flat scan, whichever its expected work makes
        cheaper.

    Parameters
    ----------
    cache : Cache or Prepared
        The first query derives tables from it, which are kept as long as it lives.
    light : Light or array_like
        What `svprep.light.parse_light` returns; or, in the cache frame, ``(x, y, z, 1)``,
        a point [m], or ``(x, y, z, 0)``, a direction towards the light, rounded to
        float32.
    method : str
        One of `METHODS`.
    volume : str
        ``"auto"``: the closed volume for solid components with the light outside
        their bounds, the robust one for the others. ``"closed"``, ``"robust"``: that
        one for all, for study; closed is wrong for components that are not solid.
    objects : array_like, optional
        Indices of the objects to look at, all by default; sorted, duplicates
        merged. The query's cost is in proportion to them, save for scratch memory.

    Raises
    ------
    InputError
        The light is not such, or names no direction; an unknown method or volume;
        an object that is not there.
    CacheError
        The tables contradict each other: the file is not as svprep writes it.
    TypeError
        `cache` is neither.

    Notes
    -----
    Twin: `reference.silhouettes`. Threads: as many as ``SVPREP_THREADS`` says.
    """
    if method not in METHODS:
        raise InputError(f"there is no method {method!r}; there are: {', '.join(METHODS)}")
    if volume not in VOLUMES:
        raise InputError(f"there is no volume {volume!r}; there are: {', '.join(VOLUMES)}")
    search = _search_of(cache)
    if isinstance(light, Light):
        light = light.in_cache_frame(search.tables.mesh.grid)
    return search.query(checked_light(light), method, volume, objects)


def _search_of(cache: Cache | Prepared) -> _Search:
    if not hasattr(cache, "edges"):
        raise TypeError(
            "expected an open cache (svprep.open_cache(PATH)) or Prepared tables, got "
            f"{type(cache).__name__}"
        )
    search = _searches.get(cache)
    if search is None:
        search = _searches[cache] = _Search(cache)
    return search


class _Search:
    """Tables and plans of one cache, each made when it is first needed."""

    def __init__(self, source: Cache | Prepared) -> None:
        self.tables = SearchTables(source)
        self._plans: dict[str, Plan] = {}
        self._scratch: list[Scratch] = []

    @cached_property
    def cones(self) -> TreeTables:
        return tree_tables(self.tables, self.tables.index.cones)

    @cached_property
    def hextree(self) -> TreeTables:
        return tree_tables(self.tables, self.tables.index.hextree)

    @cached_property
    def searching(self) -> frozenset[str]:
        """Return the methods that search any tree."""
        return frozenset(m for m, trees in self.tree_of_object.items() if (trees >= 0).any())

    def trees_of(self, method: str) -> TreeTables | None:
        """Return the trees that a method searches, None where it searches none."""
        if method not in self.searching:
            return None
        return self.cones if method == "cones" else self.hextree

    @cached_property
    def costs(self) -> F64:
        """Return the expected cost of each tree, in scanned records."""
        return tree_costs(self.tables, self.tables.index)

    @cached_property
    def tree_of_object(self) -> dict[str, I64]:
        """Return, per method, each object's tree, or -1 to scan it."""
        index = self.tables.index
        none = np.full(self.tables.n_objects, -1, np.int64)
        if len(index.objects) and int(index.objects.max()) >= len(none):
            raise contradiction("a silhouette tree is of an object that is not there")
        every, cheaper = none.copy(), none.copy()
        numbers = np.arange(len(index.objects))
        every[index.objects] = numbers
        is_cheaper = is_tree_cheaper(self.tables, index, self.costs)
        cheaper[index.objects[is_cheaper]] = numbers[is_cheaper]
        return {"flat": none, "cones": every, "hextree": every, "auto": cheaper}

    def plan(self, method: str, objects: I64 | None) -> Plan:
        """Return the plan for `objects`, all if None."""
        trees = self.trees_of(method)
        of_object = self.tree_of_object[method]
        if objects is not None:
            return make_plan(self.tables, objects, of_object[objects], trees, self.costs)
        if method not in self._plans:
            everything = np.arange(self.tables.n_objects)
            self._plans[method] = make_plan(self.tables, everything, of_object, trees, self.costs)
        return self._plans[method]

    def query(self, light: F32, method: str, volume: str, objects: ArrayLike | None) -> Silhouette:
        tables = self.tables
        chosen = None if objects is None else _checked_objects(objects, tables.n_objects)
        floor, exceptions = self._floor(light, volume, chosen)
        if method in _WALKS:
            everything = np.arange(tables.n_objects) if chosen is None else chosen
            rows = _WALKS[method](tables, everything, light, floor)
        else:
            plan = self.plan(method, chosen)
            trees = self.trees_of(method)
            floors = self._floor_of_tree(trees, volume, floor, exceptions)
            # Taken out while in use: another thread's query makes one of its own.
            try:
                scratch = self._scratch.pop()
            except IndexError:
                scratch = Scratch()
            run = Run(tables, plan, light, floor, trees, floors, method == "cones", scratch)
            rows = run.rows()
            self._scratch.append(scratch)
            everything = plan.objects
        edge, multiplicity, start, work = rows
        return Silhouette(edge, multiplicity, everything.copy(), start, light, method, work)

    def _floor(self, light: F32, volume: str, objects: I64 | None) -> tuple[I8, I64]:
        """Return the floor of each plane record for this light, and the solids excepted."""
        tables = self.tables
        none = np.zeros(0, np.int64)
        if volume in _FORCED_FLOOR:
            return read_only(np.full(len(tables.floor), _FORCED_FLOOR[volume], np.int8)), none
        if light[3] == 0.0:
            return tables.floor, none
        around = tables.solids_around(light, objects)
        if not len(around):
            return tables.floor, none
        floor = tables.floor.copy()
        solids = tables.solids
        for i in around.tolist():
            floor[solids.plane_begin[i] : solids.plane_end[i]] = -1
        return read_only(floor), around

    def _floor_of_tree(
        self, trees: TreeTables | None, volume: str, floor: I8, exceptions: I64
    ) -> I8:
        if trees is None:
            return read_only(np.zeros(0, np.int8))
        if volume in _FORCED_FLOOR:
            n_trees = len(trees.floor_of_tree)
            return read_only(np.full(n_trees, _FORCED_FLOOR[volume], np.int8))
        if not len(exceptions):
            return trees.floor_of_tree
        floors = trees.floor_of_tree.copy()
        objects = np.searchsorted(self.tables.solids.object_start, exceptions, "right") - 1
        for k in objects.tolist():
            if (tree := self.tree_of_object["hextree"][k]) >= 0:
                floors[tree] = common_floor(floor, self.tables.plane_start, k)
        return read_only(floors)


def _checked_objects(objects: ArrayLike, n_objects: int) -> I64:
    try:
        asked = np.asarray(objects)
    except ValueError:
        raise InputError("objects are a list of whole numbers, not a ragged one") from None
    if asked.size == 0:
        return np.zeros(0, np.int64)
    if asked.ndim != 1 or asked.dtype.kind not in "iu":
        raise InputError(
            f"objects are a list of whole numbers, not {asked.dtype} of shape {asked.shape} "
            "(the number of a name: cache.object_names.index(NAME))"
        )
    beyond = asked[(asked < 0) | (asked >= n_objects)]
    if len(beyond):
        raise InputError(
            f"there is no object {beyond[0]}: the cache has {n_objects}, numbered from 0"
        )
    return np.unique(asked).astype(np.int64)


_searches: WeakKeyDictionary[Cache | Prepared, _Search] = WeakKeyDictionary()

"""Tables that no build makes are refused before a kernel goes astray on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from svprep.errors import CacheError
from svprep.model import NO_INDEX, Prepared
from svprep.silhouette import METHODS, silhouette
from tests.dataset.datasets import DATA, build_with_trees


@pytest.fixture(scope="module")
def city() -> Prepared:
    """Return the sample city with trees for many objects."""
    return build_with_trees(DATA / "small_city.obj.gz", 30)


def changed(city: Prepared, path: str, change: Callable[[np.ndarray], Any]) -> Prepared:
    """Return a copy with one array of one table changed: in place, or for what is returned."""
    *tables, name = path.split(".")
    chain = [city]
    for table in tables:
        chain.append(getattr(chain[-1], table))
    array = np.array(getattr(chain[-1], name))
    array = found if isinstance(found := change(array), np.ndarray) else array
    value: Any = replace(chain[-1], **{name: array})
    for owner, table in zip(reversed(chain[:-1]), reversed(tables), strict=True):
        value = replace(owner, **{table: value})
    return value


def put(at: Any, value: int) -> Callable[[np.ndarray], None]:
    """Return a change of some elements."""

    def change(array: np.ndarray) -> None:
        array[at] = value

    return change


TREES = {
    "pair start beyond": ("index.pair_start", put(-1, 10**8)),
    "pair start far beyond": ("index.pair_start", put(-1, 4 * 10**9)),
    "pair start falls": ("index.pair_start", put(1, 10**6)),
    "objects reversed": ("index.objects", lambda a: np.ascontiguousarray(a[::-1])),
    "objects equal": ("index.objects", put(slice(None), 3)),
    "object beyond": ("index.objects", put(-1, 10**6)),
    "radius zero": ("index.frames", put((0, 3), 0)),
    "too few blocks": ("index.hextree.blocks", lambda a: a[:-1].copy()),
    "edge beyond": ("index.hextree.edge", put(5, 10**8)),
    "edge of another object": ("index.hextree.edge", put(slice(None), 0)),
}
TABLES = {
    "edge start beyond": ("components.edge_start", put(3, 10**7)),
    "edge start falls": ("components.edge_start", put(3, 10**5 // 2)),
    "face start falls": ("components.face_start", put(3, 20_000)),
    "object faces beyond": ("mesh.object_face_start", put(4, 10**7)),
    "plane beyond": ("planes.plane_of_face", put(7, 10**8)),
    "planes out of order": ("planes.plane_of_face", lambda a: a[::-1].copy()),
    "flags too few": ("edges.flags", lambda a: a[:-1].copy()),
}


@pytest.mark.parametrize("case", TREES)
def test_trees_that_do_not_fit(city: Prepared, case: str) -> None:
    broken = changed(city, *TREES[case])
    with pytest.raises(CacheError, match=r"contradict each other.*svprep validate"):
        silhouette(broken, [0.3, 0.4, 0.5, 0.0], "hextree")


@pytest.mark.parametrize("case", TABLES)
@pytest.mark.parametrize("method", METHODS)
def test_tables_that_do_not_fit(city: Prepared, case: str, method: Any) -> None:
    broken = changed(city, *TABLES[case])
    with pytest.raises(CacheError, match=r"contradict each other.*svprep validate"):
        silhouette(broken, [0.3, 0.4, 0.5, 0.0], method)


@pytest.mark.parametrize("method", ["edge_buffer", "elimination"])
def test_a_side_in_no_record(city: Prepared, method: Any) -> None:
    broken = changed(city, "edges.rows", put((10, slice(2, 4)), NO_INDEX))
    with pytest.raises(CacheError, match="no edge record of its object"):
        silhouette(broken, [0.3, 0.4, 0.5, 0.0], method)


def test_what_is_no_cache_is_named() -> None:
    with pytest.raises(TypeError, match="expected an open cache"):
        silhouette(None, [0, 0, 1, 0])  # type: ignore[arg-type]

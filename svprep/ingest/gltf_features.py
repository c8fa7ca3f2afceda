"""Which feature each triangle of a glTF primitive belongs to.

A set of feature ids is an attribute with a number per vertex. Of several sets, the first
that names rows of a property table is taken, else the first. Ids that name rows of one
table are the same features in every mesh of the file; other ids count anew in each node.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from svprep.ingest.gltf_buffers import natural
from svprep.ingest.gltf_properties import FeatureLabels, FeatureTable, label_features
from svprep.ingest.parsed import count_of, shown
from svprep.model import I64

BATCH_TABLE: Final = "batch table"
"""What the batch table of a ``.b3dm`` is called among property tables."""
NO_FEATURE: Final = -1

_BARE: Final = re.compile(r"_FEATURE_ID(_\d+)?")
_BATCH_ID: Final = re.compile(r"_?BATCHID")
_MOST_EXACT: Final = float(1 << 53)


@dataclass(frozen=True, slots=True)
class FeatureSet:
    """One way in which a primitive tells features apart."""

    label: str
    attribute: str = ""
    """The attribute that holds the ids, or ``""``."""
    table: Hashable | None = None
    null_id: int | None = None
    constant: int = 0
    """Without an attribute: vertex i is of feature ``constant + i // divisor``."""
    divisor: int = 0
    n_announced: int = 0
    is_readable: bool = True


def _feature_sets(primitive: dict[str, Any], has_batch_table: bool) -> Iterator[FeatureSet]:
    """Yield the sets of a primitive."""
    attributes = primitive["attributes"]
    extensions = primitive.get("extensions", {})
    seen = set()
    for entry in extensions.get("EXT_mesh_features", {}).get("featureIds", []):
        name = f"_FEATURE_ID_{entry['attribute']}" if "attribute" in entry else ""
        label = name or ("a texture" if "texture" in entry else "one per vertex")
        n_announced = int(entry.get("featureCount", 0))
        table = entry.get("propertyTable")
        null_id = natural(entry["nullFeatureId"]) if "nullFeatureId" in entry else None
        is_readable = name in attributes
        seen.add(name)
        yield FeatureSet(label, name, table, null_id, 0, 0, n_announced, is_readable)
    older = extensions.get("EXT_feature_metadata", {})
    for entry in older.get("featureIdAttributes", []):
        ids, table = entry["featureIds"], entry.get("featureTable")
        if name := str(ids.get("attribute", "")):
            seen.add(name)
            yield FeatureSet(name, name, table, is_readable=name in attributes)
        else:
            constant, divisor = natural(ids.get("constant", 0)), natural(ids.get("divisor", 0))
            yield FeatureSet("by constant and divisor", "", table, None, constant, divisor)
    for entry in older.get("featureIdTextures", []):
        yield FeatureSet("a texture", "", entry.get("featureTable"), is_readable=False)
    for name in sorted(name for name in attributes if name[:1] in ("_", "B")):
        if _BATCH_ID.fullmatch(name):
            yield FeatureSet(name, name, BATCH_TABLE if has_batch_table else None)
        elif _BARE.fullmatch(name) and name not in seen:
            yield FeatureSet(name, name)


class Features:
    """The features of one file while it is read."""

    def __init__(self, tables: dict[Hashable, FeatureTable]) -> None:
        self._tables = tables
        self._labels: dict[Hashable, FeatureLabels] = {}
        self._unread: Counter[str] = Counter()
        self._further: set[str] = set()
        self._beyond: set[tuple[Hashable, int]] = set()
        self._n_mixed = 0
        self._n_unnamed = 0

    def chosen(self, primitive: dict[str, Any]) -> FeatureSet | None:
        """Return the set of ids that tells the objects of a primitive apart, if there is one."""
        sets = list(_feature_sets(primitive, BATCH_TABLE in self._tables))
        readable = [s for s in sets if s.is_readable]
        for unread in (s for s in sets if not s.is_readable):
            self._unread[unread.label] = max(self._unread[unread.label], unread.n_announced)
        chosen = next((s for s in readable if s.table is not None), next(iter(readable), None))
        self._further.update(s.label for s in readable if s is not chosen)
        return chosen

    def of_triangles(
        self,
        chosen: FeatureSet,
        values: Callable[[str], NDArray[np.generic]],
        triangles: I64,
        n_vertices: int,
    ) -> I64:
        """Return the feature of each triangle, `NO_FEATURE` where it has none.

        Parameters
        ----------
        values
            Returns the values of an attribute, ``(n_vertices, 1)``.
        triangles : (n, 3) int64

        Notes
        -----
        A triangle goes by its first corner; those whose corners differ are counted.
        """
        if not chosen.attribute:
            vertex = np.arange(n_vertices, dtype=np.int64)
            ids = chosen.constant + (vertex // chosen.divisor if chosen.divisor else 0 * vertex)
            is_named = np.ones(n_vertices, np.bool_)
        else:
            raw = values(chosen.attribute)
            if raw.shape != (n_vertices, 1):
                raise ValueError(
                    f"{chosen.attribute} has the shape {raw.shape}, not ({n_vertices}, 1)"
                )
            number = raw[:, 0].astype(np.float64)
            is_named = (number >= 0) & (number < _MOST_EXACT) & (number == np.floor(number))
            ids = np.where(is_named, number, NO_FEATURE).astype(np.int64)
        if chosen.null_id is not None:
            is_null = ids == chosen.null_id
            ids = np.where(is_null, NO_FEATURE, ids)
            is_named |= is_null
        first, second, third = ids[triangles.T]
        self._n_mixed += int(((first != second) | (first != third)).sum())
        self._n_unnamed += int((~is_named[triangles[:, 0]]).sum())
        return first

    def labels(self, table: Hashable) -> FeatureLabels:
        """Return what the features of a table are called."""
        if table not in self._labels:
            self._labels[table] = label_features(self._tables.get(table, FeatureTable(0)))
        return self._labels[table]

    def row(self, table: Hashable, feature: int) -> tuple[str, str, str]:
        """Return the name, type and parent of one feature."""
        labels = self.labels(table)
        if feature >= labels.n_features and table in self._tables:
            self._beyond.add((table, feature))
        name = labels.name(feature)
        object_type = labels.types[feature] if feature < len(labels.types) else ""
        parent = labels.parents[feature] if feature < len(labels.parents) else ""
        return name, object_type, parent

    def notes(self) -> list[str]:
        """Say how features were told apart, and what of them was not."""
        notes = []
        named_by = sorted({labels.named_by for labels in self._labels.values()} - {""})
        if named_by:
            listed = ", ".join(f'"{shown(name)}"' for name in named_by)
            notes.append(f"features are objects, named by their property {listed}")
        if self._further:
            listed = ", ".join(map(shown, sorted(self._further)))
            notes.append(f"further sets of feature ids are not read: {listed}")
        for label, n in self._unread.items():
            announced = f"{count_of(n, 'object')} as " if n else ""
            notes.append(
                f"holds {announced}feature ids ({shown(label)}), which are not read: their "
                "triangles are left to their node's object"
            )
        if self._n_mixed:
            notes.append(
                f"{count_of(self._n_mixed, 'triangle')} with corners of different features: "
                "taken by the first corner"
            )
        if self._n_unnamed:
            notes.append(
                f"{count_of(self._n_unnamed, 'triangle')} with a feature id that is negative or "
                "no whole number: left to their node's object"
            )
        if self._beyond:
            found = count_of(len(self._beyond), "feature id")
            notes.append(f"{found} beyond the rows of their property table: named by number")
        return notes

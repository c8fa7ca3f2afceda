"""What glTF and 3D Tiles say of features: property tables, and the labels in them.

Read are EXT_structural_metadata, EXT_feature_metadata before it, and the batch table of
``.b3dm``. A feature's name is, of the first of these that there is:

    1. the property with the semantic "ID"
    2. of the properties called as in `_ID_NAMES`, in that order (capitals, "_", "-" and
       ":" aside), the first with at least half of its values different and none empty:
       a table may have several rows of one building
    3. the first text property whose values are all different and none empty
    4. "feature_17"

Its type and its parent come from text properties called as in `_TYPE_NAMES` and
`_PARENT_NAMES`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from svprep.ingest.gltf_buffers import Buffers, natural
from svprep.ingest.parsed import encodable

_ID_NAMES: Final = (
    *("id", "identificatie", "gmlid", "cityobjectid", "fid", "featureid", "objectid"),
    *("buildingid", "globalid", "uuid", "guid", "osmid", "name"),
)
_TYPE_NAMES: Final = ("type", "cityobjecttype", "objecttype", "featuretype", "class", "classname")
_PARENT_NAMES: Final = ("parent", "parentid", "gmlparentid", "cityobjectparent")
_NUMBERS: Final = {
    **{f"INT{8 * n}": f"<i{n}" for n in (1, 2, 4, 8)},
    **{f"UINT{8 * n}": f"<u{n}" for n in (1, 2, 4, 8)},
    "FLOAT32": "<f4",
    "FLOAT64": "<f8",
}
_OFFSETS: Final = {f"UINT{8 * n}": f"<u{n}" for n in (1, 2, 4, 8)}


@dataclass(frozen=True, slots=True)
class Column:
    """One property of every feature of a table."""

    name: str
    semantic: str
    is_text: bool
    read: Callable[[], list[str]]
    """Returns its values, ``""`` where there is none."""


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """The properties that may label features; others are not looked at."""

    n_features: int
    columns: tuple[Column, ...] = ()


@dataclass(frozen=True, slots=True)
class FeatureLabels:
    """What objects that are features are called."""

    n_features: int
    names: Sequence[str]
    """``(n_features,)``, or empty where no property names them."""
    types: Sequence[str]
    parents: Sequence[str]
    named_by: str
    """The property that names them, or ``""``."""

    def name(self, feature: int) -> str:
        """Return the name of one feature."""
        name = self.names[feature] if feature < len(self.names) else ""
        return name or f"feature_{feature}"


def label_features(table: FeatureTable) -> FeatureLabels:
    """Choose the properties that name features and their types and parents."""
    named_by, names = _names(table)
    others = [
        next(
            (
                values
                for column in _called(table, wanted)
                if column.is_text and not _are_numbers(values := column.read())
            ),
            [],
        )
        for wanted in (_TYPE_NAMES, _PARENT_NAMES)
    ]
    return FeatureLabels(table.n_features, names, others[0], others[1], named_by)


def _names(table: FeatureTable) -> tuple[str, list[str]]:
    """Return the property that names features, and its values."""
    for column in table.columns:
        if column.semantic.upper() == "ID":
            return column.name, column.read()
    called = list(_called(table, _ID_NAMES))
    texts = [column for column in table.columns if column.is_text and column not in called]
    for column in (*called, *texts):
        values = column.read()
        n_different = len(set(values)) * (2 if column in called else 1)
        if "" not in values and n_different >= len(values) > 0:
            return column.name, values
    return "", []


def _called(table: FeatureTable, names: Sequence[str]) -> Iterator[Column]:
    """Yield the columns with one of these names, in the order of the names."""
    plain = [re.sub(r"[^a-z0-9]", "", column.name.lower()) for column in table.columns]
    for name in names:
        yield from (c for c, text in zip(table.columns, plain, strict=True) if text == name)


def _are_numbers(values: list[str]) -> bool:
    """Return whether there is nothing but codes: those say nothing without their list."""
    return not any(value and not value.isdecimal() for value in values)


def number_text(value: float) -> str:
    """Return a number as an id: ``"17"`` of 17.0, too."""
    return str(int(value)) if float(value).is_integer() else repr(float(value))


def property_tables(buffers: Buffers) -> dict[Hashable, FeatureTable]:
    """Return the property tables of a file, by what feature ids call them: index or name."""
    extensions = buffers.tree.get("extensions", {})
    found = extensions.get("EXT_structural_metadata", {})
    tables: dict[Hashable, FeatureTable] = {
        i: _table(table, found.get("schema", {}), buffers, "values")
        for i, table in enumerate(found.get("propertyTables", []))
    }
    found = extensions.get("EXT_feature_metadata", {})
    for name, table in found.get("featureTables", {}).items():
        tables[name] = _table(table, found.get("schema", {}), buffers, "bufferView")
    return tables


def _table(
    table: dict[str, Any], schema: dict[str, Any], buffers: Buffers, values_key: str
) -> FeatureTable:
    """Return one property table; `values_key` is where its properties keep their values."""
    count = natural(table.get("count", 0))
    kinds = schema.get("classes", {}).get(table.get("class"), {}).get("properties", {})
    columns = []
    for name, place in table.get("properties", {}).items():
        kind = kinds.get(name, {})
        type_name = kind.get("type")
        is_text = type_name in ("STRING", "ENUM")
        number = kind.get("componentType") if type_name == "SCALAR" else type_name
        if kind.get("array") or values_key not in place or not (is_text or number in _NUMBERS):
            continue
        if type_name == "ENUM":
            if (enum := schema.get("enums", {}).get(kind.get("enumType"))) is None:
                continue
            read = _enum_reader(buffers, place[values_key], count, enum)
        elif type_name == "STRING":
            read = _text_reader(buffers, place, values_key, count)
        else:
            read = _number_reader(buffers, place[values_key], count, _NUMBERS[number])
        read = _without(str(kind["noData"]), read) if "noData" in kind else read
        semantic = str(kind.get("semantic", ""))
        columns.append(Column(encodable(str(name)), semantic, is_text, read))
    return FeatureTable(count, tuple(columns))


def _without(no_data: str, read: Callable[[], list[str]]) -> Callable[[], list[str]]:
    """Return a reader that gives "" for the value that stands for none."""
    return lambda: ["" if value == no_data else value for value in read()]


def _number_reader(buffers: Buffers, view: int, count: int, dtype: str) -> Callable[[], list[str]]:
    def read() -> list[str]:
        values = np.frombuffer(buffers.view(view), dtype, count)
        return list(map(number_text if values.dtype.kind == "f" else str, values.tolist()))

    return read


def _enum_reader(
    buffers: Buffers, view: int, count: int, enum: dict[str, Any]
) -> Callable[[], list[str]]:
    def read() -> list[str]:
        dtype = _NUMBERS[enum.get("valueType", "UINT16")]
        names = {entry["value"]: encodable(str(entry["name"])) for entry in enum["values"]}
        values = np.frombuffer(buffers.view(view), dtype, count).tolist()
        return [names.get(value, str(value)) for value in values]

    return read


def _text_reader(
    buffers: Buffers, place: dict[str, Any], values_key: str, count: int
) -> Callable[[], list[str]]:
    is_older = values_key == "bufferView"
    offsets_key = "stringOffsetBufferView" if is_older else "stringOffsets"
    type_key = "offsetType" if is_older else "stringOffsetType"

    def read() -> list[str]:
        text = bytes(buffers.view(place[values_key]))
        dtype = _OFFSETS[place.get(type_key, "UINT32")]
        offsets = np.frombuffer(buffers.view(place[offsets_key]), dtype, count + 1)
        ends = offsets.astype(np.int64)
        if ends.min() < 0 or (ends[1:] < ends[:-1]).any() or ends[-1] > len(text):
            raise ValueError("the texts of a property table lie outside their bufferView")
        limits = ends.tolist()
        return [encodable(text[a:b].decode("utf-8", "replace")) for a, b in pairwise(limits)]

    return read

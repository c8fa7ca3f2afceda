"""The quick check of a cache file: structure, digests, values, tables.

`verify` never trusts what it reads. Damage is named by dataset; what depends
on a damaged dataset is not checked further, so that one flipped byte is one
line. The codes are explained in `CHECKS`.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from svprep.cache.checks import CHECKS, Check, Problem
from svprep.cache.codec import decode_place, decode_sources
from svprep.cache.invariants import check_tables
from svprep.cache.schema import (
    ATTRIBUTE_OF_NAME,
    ATTRIBUTES,
    DATASETS,
    DIGESTS_PATH,
    LISTS,
    SPEC_OF_PATH,
    item_digest,
    shape_problem,
)
from svprep.cache.storage import (
    DAMAGE,
    attribute_value,
    check_root,
    frozen_view,
    open_hdf5,
    read_digest_table,
    read_raw,
    stored_dataset,
)
from svprep.cache.tables import Tables
from svprep.cache.vtkhdf import GROUP as VTK_GROUP
from svprep.cache.vtkhdf import check_vtk

__all__ = ["CHECKS", "Check", "Problem", "verify"]

Values = dict[str, bytes | NDArray[np.generic]]
HASH_THREADS = 4


def verify(path: str | os.PathLike[str]) -> list[Problem]:
    """Return everything that is wrong with the cache file `path`; empty when it is whole.

    Raises
    ------
    CacheError
        The file cannot be opened as a cache of this schema at all: missing,
        foreign, truncated, of another schema. No other error, whatever the
        file holds.

    Notes
    -----
    Reads every byte once. O(n log n) in the number of edge records.
    """
    with open_hdf5(Path(path)) as file:
        problems = _unknown_items(file)
        values, found = _attributes(file)
        problems += found
        arrays, sizes, found = _datasets(file)
        problems += found
        damaged, found = _digests(file, arrays, values)
        problems += found
        whole = {name: array for name, array in arrays.items() if name not in damaged}
        problems += _vtk(file, whole, values)
    if "grid_step_m" not in values or "planar_tolerance_m" not in values:
        return problems
    step, tolerance = float(values["grid_step_m"]), float(values["planar_tolerance_m"])
    if not (math.isfinite(step) and step > 0):
        return problems
    return problems + check_tables(Tables(whole, sizes, step, tolerance))


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split()).strip("'\"") or type(error).__name__


def _unknown_items(file: h5py.File) -> list[Problem]:
    """Return the members of the root and of the declared groups that no one declared."""
    declared = {*SPEC_OF_PATH, DIGESTS_PATH}
    groups = sorted({path.split("/")[0] for path in SPEC_OF_PATH})
    problems = []
    for group in ("", *groups):
        try:
            names = [f"{group}/{name}".lstrip("/") for name in (file[group] if group else file)]
        except DAMAGE as error:
            problems.append(Problem("V104", group or "the root group", _reason(error)))
            continue
        known_groups = () if group else (*groups, VTK_GROUP)
        unknown = [n for n in names if n not in declared and n not in known_groups]
        problems += [Problem("V103", name, "it is not part of the schema") for name in unknown]
    try:
        known = {spec.name for spec in ATTRIBUTES}
        extra = [name for name in file.attrs if name not in known]
    except DAMAGE as error:
        return [*problems, Problem("V104", "the root attributes", _reason(error))]
    return problems + [Problem("V103", f"attribute {n}", "it is not in the schema") for n in extra]


def _attributes(file: h5py.File) -> tuple[Values, list[Problem]]:
    values: Values = {}
    problems = []
    for spec in ATTRIBUTES:
        where = f"attribute {spec.name}"
        try:
            if spec.name not in file.attrs:
                problems.append(Problem("V101", where, f"it is missing ({spec.meaning})"))
                continue
            values[spec.name] = attribute_value(file, spec)
        except ValueError as error:
            problems.append(Problem("V102", where, _reason(error)))
        except DAMAGE as error:
            problems.append(Problem("V104", where, _reason(error)))
    return values, problems + _attribute_values(values)


def _attribute_values(values: Values) -> list[Problem]:
    """Return what is wrong with the values of the attributes that are there."""
    problems = []
    parsed: dict[str, Any] = {}
    objects = ("config", "place")
    for spec in ATTRIBUTES:
        if not spec.is_text or spec.name not in values:
            continue
        try:
            text = bytes(values[spec.name]).decode()
            if spec.dtype == "json":
                parsed[spec.name] = json.loads(text)
                kind = dict if spec.name in objects else list
                if not isinstance(parsed[spec.name], kind):
                    raise ValueError(f"expected a JSON {kind.__name__}")
        except DAMAGE as error:
            problems.append(Problem("V105", f"attribute {spec.name}", _reason(error)))
    try:
        if "sources" in parsed and "source_paths" in parsed:
            decode_sources(parsed["source_paths"], parsed["sources"])
    except DAMAGE as error:
        problems.append(Problem("V105", "attribute sources", _reason(error)))
    try:
        decode_place("", parsed.get("place", {}))
    except DAMAGE as error:
        problems.append(Problem("V105", "attribute place", _reason(error)))
    for name in ("object_types", "surface_names"):
        texts = parsed.get(name, [""])
        if not (texts and texts[0] == "" and all(isinstance(text, str) for text in texts)):
            message = 'expected texts, the first of them ""'
            problems.append(Problem("V105", f"attribute {name}", message))
    return problems + _number_values(values)


def _number_values(values: Mapping[str, bytes | NDArray[np.generic]]) -> list[Problem]:
    problems = []
    step = float(values.get("grid_step_m", 1.0))
    if not (math.isfinite(step) and step > 0 and math.frexp(step)[0] == 0.5):
        message = f"expected a power of two, got {step!r}"
        problems.append(Problem("V105", "attribute grid_step_m", message))
    else:
        origin = np.asarray(values.get("grid_origin_m", ()), np.float64).tolist()
        if not all(math.isfinite(x) and math.fmod(x, step) == 0 for x in origin):
            message = f"expected finite multiples of the step {step!r}, got {origin}"
            problems.append(Problem("V105", "attribute grid_origin_m", message))
    tolerance = float(values.get("planar_tolerance_m", 0.0))
    if not (math.isfinite(tolerance) and tolerance >= 0):
        message = f"expected a length of at least 0 m, got {tolerance!r}"
        problems.append(Problem("V105", "attribute planar_tolerance_m", message))
    return problems


def _datasets(
    file: h5py.File,
) -> tuple[dict[str, NDArray[np.generic]], dict[str, int], list[Problem]]:
    arrays: dict[str, NDArray[np.generic]] = {}
    sizes: dict[str, int] = {}
    problems = []
    for spec in DATASETS:
        try:
            dataset = stored_dataset(file, spec.path)
            if wrong := shape_problem(spec, dataset.dtype, dataset.shape, sizes):
                problems.append(Problem("V102", spec.path, wrong))
                continue
            arrays[spec.path] = frozen_view(read_raw(dataset), spec)
        except KeyError:
            problems.append(Problem("V101", spec.path, "it is missing"))
        except ValueError as error:
            problems.append(Problem("V102", spec.path, _reason(error)))
        except DAMAGE as error:
            problems.append(Problem("V104", spec.path, _reason(error)))
    for symbol, name in LISTS.items():
        with contextlib.suppress(*DAMAGE):  # reported with the attributes
            text = attribute_value(file, ATTRIBUTE_OF_NAME[name])
            sizes[symbol] = len(json.loads(bytes(text)))
    return arrays, sizes, problems


def _vtk(
    file: h5py.File, whole: Mapping[str, NDArray[np.generic]], values: Values
) -> list[Problem]:
    """Return what is wrong with what other programs are shown."""
    origin = values.get("grid_origin_m")
    found: list[Problem] = []
    try:
        found.extend(check_vtk(file, whole, None if isinstance(origin, bytes) else origin))
    except DAMAGE as error:
        found.append(Problem("V104", VTK_GROUP, _reason(error)))
    return found


def _digests(
    file: h5py.File, arrays: Mapping[str, NDArray[np.generic]], values: Values
) -> tuple[set[str], list[Problem]]:
    """Return the datasets whose bytes are not those that were written, and the problems."""
    try:
        table = read_digest_table(file)
    except KeyError:
        return set(), [Problem("V101", DIGESTS_PATH, "it is missing")]
    except ValueError as error:
        return set(), [Problem("V102", DIGESTS_PATH, _reason(error))]
    except DAMAGE as error:
        return set(), [Problem("V104", DIGESTS_PATH, _reason(error))]
    problems = []
    if [name for name, _ in table] != [spec.path for spec in DATASETS]:
        message = "it does not list the declared datasets in their order"
        problems.append(Problem("V202", DIGESTS_PATH, message))
    if len(values) == len(ATTRIBUTES):
        try:
            check_root(values, table)
        except ValueError as error:
            problems.append(Problem("V202", "digest table or attributes", _reason(error)))
    with ThreadPoolExecutor(HASH_THREADS) as pool:
        paths = list(arrays)
        found = pool.map(lambda p: item_digest(p, SPEC_OF_PATH[p].dtype, arrays[p]), paths)
        got = dict(zip(paths, found, strict=True))
    expected = dict(table)
    damaged = {path for path in paths if path in expected and got[path] != expected[path]}
    for path in paths:
        if path in damaged:
            message = f"its SHA-256 begins with {got[path][:12]}, expected {expected[path][:12]}"
            problems.append(Problem("V201", path, message))
    return damaged, problems

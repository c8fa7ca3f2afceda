"""A digest that is begun early is that of the file as it is read, or none."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from svprep import source_digest
from svprep.ingest.file_bytes import Text

SIZE = source_digest.LEAST_BYTES + 12_345


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.obj"
    path.write_bytes(os.urandom(SIZE))
    return path


def early(path: Path) -> str | None:
    with path.open("rb") as file:
        return source_digest.of(file.fileno())


def test_it_is_that_of_the_file(model: Path) -> None:
    source_digest.begin([str(model)])
    assert early(model) == hashlib.sha256(model.read_bytes()).hexdigest()
    assert Text.of(model).sha256() == early(model)


@pytest.mark.parametrize("is_replaced", [True, False])
def test_a_file_that_changed_is_hashed_as_it_is_now(model: Path, is_replaced: bool) -> None:
    source_digest.begin([str(model)])
    before = early(model)
    if is_replaced:
        other = model.with_suffix(".new")
        other.write_bytes(os.urandom(SIZE))
        other.replace(model)
    else:
        with model.open("r+b") as file:
            file.write(b"v 1 2 3\n")
        status = model.stat()
        os.utime(model, ns=(status.st_atime_ns, status.st_mtime_ns + 1_000_000))
    assert early(model) is None
    assert Text.of(model).sha256() == hashlib.sha256(model.read_bytes()).hexdigest() != before


def test_nothing_is_begun_that_need_not_be(model: Path, tmp_path: Path) -> None:
    small = tmp_path / "small.obj"
    small.write_bytes(b"v 0 0 0\n")
    other = tmp_path / "model.city.json"  # read whole, and hashed then
    other.write_bytes(model.read_bytes())
    folder = tmp_path / "folder.obj"
    folder.mkdir()
    for inputs in (
        [], [str(small)], [str(model), str(small)], [str(other)], [str(folder)],
        ["a\0b.obj"], ["none.obj"],
    ):  # fmt: skip
        source_digest.begin(inputs)
    assert early(model) is None
    assert early(small) is None
    assert early(other) is None

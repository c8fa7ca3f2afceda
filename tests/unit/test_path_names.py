"""What files are called where their names alone do not tell them apart."""

from __future__ import annotations

import pytest

from svprep.path_names import told_apart


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        ([], ()),
        (["x/city.gml"], ("city.gml",)),
        (["x/city.gml", "x/other.gml"], ("city.gml", "other.gml")),
        (["x/a/city.gml", "x/b/city.gml"], ("a/city.gml", "b/city.gml")),
        (["city.gml", "b/city.gml", "c.gml"], ("city.gml", "b/city.gml", "c.gml")),
        (["/a/t/0.glb", "/b/t/0.glb"], ("a/t/0.glb", "b/t/0.glb")),
        (["a/x", "b/x", "c/b/x"], ("a/x", "b/x", "c/b/x")),
        (["a/x", "a/x"], ("a/x", "a/x")),  # nothing tells them apart
        (["", "."], (".", ".")),
    ],
)
def test_the_shortest_end_that_no_other_has(paths: list[str], names: tuple[str, ...]) -> None:
    assert told_apart(paths) == names

"""Each named broken mesh gives exactly the counts that the manifest expects."""

from __future__ import annotations

import pytest

from svprep.defects import DEFECTS
from svprep.model import Prepared
from svprep.report import component_counts
from tests.dataset.datasets import DATA, build, manifest

EXPECTED = {n: e["expect"] for n, e in manifest().items() if "refused" not in e["expect"]}


def counts(prepared: Prepared) -> dict[str, int]:
    """Return what a manifest entry may expect, by its names."""
    defects = prepared.repair.defect_counts.sum(axis=0).tolist()
    return {
        "objects": len(prepared.object_names),
        "faces": len(prepared.mesh.faces),
        "vertices": len(prepared.mesh.positions),
        **component_counts(prepared.components.flags),
        **{code.name: n for code, n in zip(DEFECTS, defects, strict=True) if n},
    }


@pytest.mark.parametrize("name", EXPECTED)
def test_expected_counts(name: str) -> None:
    outcome = build(DATA / name)
    assert not isinstance(outcome, str), outcome
    expect = dict(EXPECTED[name])
    defects, unstated = expect.pop("defects", {}), set(expect.pop("unstated", ()))
    found = counts(outcome.prepared)
    if name.startswith("conformance/"):
        expect |= {code.name: defects.get(code.name, 0) for code in DEFECTS}
    assert {k: found.get(k, 0) for k in expect if k not in unstated} == {
        k: n for k, n in expect.items() if k not in unstated
    }


def test_every_defect_is_shown_by_some_file() -> None:
    shown = {code for expect in EXPECTED.values() for code in expect.get("defects", {})}
    assert {code.name for code in DEFECTS} <= shown

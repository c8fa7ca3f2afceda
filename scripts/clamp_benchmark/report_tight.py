"""The part of the report that says how tight shadows are clamped, and what bounds it."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from typing import Protocol

from clamp_benchmark.tight import (
    ALL_UNCLAMPED,
    ALL_WHOLE_OBJECTS,
    CLAMPED,
    CUT_FACES,
    FREE_GAPS,
    LAST_SURFACE,
    OWN_BOX,
    SINGLE_FACES,
    UNCLAMPED,
    WHOLE_OBJECTS,
    Tight,
)
from clamp_benchmark.views import VIEWS
from silhouette_benchmark.report import table


class ModelFigures(Protocol):
    """What `models` needs of a model."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def objects(self) -> int: ...  # noqa: D102
    @property
    def casters(self) -> int: ...  # noqa: D102
    @property
    def triangles(self) -> int: ...  # noqa: D102
    @property
    def tight(self) -> list[Tight]: ...  # noqa: D102


def city_tight(name: str, tight: Sequence[Tight]) -> Iterator[str]:
    """Yield all figures of the generated city."""
    pixels = tight[0].pixels
    yield f"### {name}"
    yield ""
    yield (
        f"{tight[0].n_casters:,} casters; {sum(pixels):,} pixels are not sky. Updates a pixel, "
        "mean of all views:"
    )
    yield ""
    names = (UNCLAMPED, OWN_BOX, CLAMPED, SINGLE_FACES, FREE_GAPS, CUT_FACES, WHOLE_OBJECTS)
    rows = [
        (
            f"{t.altitude_deg:g}",
            *(_number(t.per_pixel(name)) for name in names),
            _number(t.held / max(sum(t.pixels), 1)),
            _number(t.floor / max(sum(t.pixels), 1)),
        )
        for t in tight
    ]
    yield from table(["altitude", *names, "visible points", "floor"], rows)
    yield ""
    yield (
        "Gains. Share: gain over that of own boxes, the target. Share at the floor: if every "
        "volume cost its floor and not one update more."
    )
    yield ""
    head = ["altitude", "gain", "own box", "share", "views, median", "range", "share at the floor",
            "single faces, share", "cut faces, share"]  # fmt: skip
    rows = [
        (
            f"{t.altitude_deg:g}", _number(t.gain()), _number(t.gain(OWN_BOX)),
            f"{t.share_of_own_box:.3f}", f"{statistics.median(t.view_shares):.2f}",
            f"{min(t.view_shares):.2f}-{max(t.view_shares):.2f}", f"{t.most_share:.2f}",
            f"{t.gain(SINGLE_FACES) / t.gain(OWN_BOX):.3f}",
            f"{t.gain(CUT_FACES) / t.gain(OWN_BOX):.3f}",
        )
        for t in tight
    ]  # fmt: skip
    yield from table(head, rows)
    yield ""
    yield from _bounded(tight)
    yield ""
    yield from _published(tight)
    yield ""
    yield from _areas(tight)
    yield ""
    yield "Updates a pixel, view by view (unclamped / own box / clamped):"
    yield ""
    head = ["altitude", *(view.name for view in VIEWS)]
    rows = [
        (
            f"{t.altitude_deg:g}",
            *(
                f"{whole:,.0f} / {_number(own)} / {_number(clamped)}"
                for whole, own, clamped in zip(
                    *(t.updates[name].per_view for name in (UNCLAMPED, OWN_BOX, CLAMPED)),
                    strict=True,
                )
            ),
        )
        for t in tight
    ]
    yield from table(head, rows)


def _bounded(tight: Sequence[Tight]) -> Iterator[str]:
    """Yield what keeps the gain from that of own boxes."""
    yield (
        "What bounds it. A shadow is as long as its way to the ground, which at a low sun is far "
        "longer than the caster's own box. Lengths along the light from the caster's front, on "
        "the middle line of its rectangle, means over casters [m]:"
    )
    yield ""
    head = ["altitude", "own box", "to the last surface", "clamped, its end", "clamped, no gaps",
            "unclamped"]  # fmt: skip
    rows = [
        (
            f"{t.altitude_deg:g}", f"{t.lengths.own_box:.1f}", f"{t.lengths.to_last_surface:.1f}",
            f"{t.lengths.clamped_end:.1f}", f"{t.lengths.clamped:.1f}",
            f"{t.lengths.unclamped:,.0f}",
        )
        for t in tight
    ]  # fmt: skip
    yield from table(head, rows)
    yield ""
    for t in tight:
        ours, own = t.updates[CLAMPED].total, max(t.updates[OWN_BOX].total, 1)
        faces, free, cut = (
            1.0 - t.updates[name].total / max(ours, 1)
            for name in (SINGLE_FACES, FREE_GAPS, CUT_FACES)
        )
        last = t.updates[LAST_SURFACE]
        yield (
            f"- {t.altitude_deg:g} degrees: the floor is {t.floor / own:.2f} times what own boxes "
            f"cost ({t.held / own:.2f} from visible points alone, the rest from hidden ones), so "
            f"no right clamping has a share above {t.most_share:.2f}. Clamped volumes cost "
            f"{ours / max(t.floor, 1):.2f} times the floor. Single faces as receivers save "
            f"{faces:.1%}; if gaps cost nothing, too, {free:.1%}. Faces that are cut to the "
            f"rectangle save {cut:.1%}, without any gap. Volumes that end at the last surface on "
            f"their middle line (they miss {last.left_out:,} of {t.held:,} visible points, so "
            f"cannot be drawn) would have a share of {own / max(last.total, 1):.2f}."
        )


def _published(tight: Sequence[Tight]) -> Iterator[str]:
    """Yield the comparison with whole objects."""
    yield (
        "The published way. Casters are components, or whole objects (whose unclamped volumes are "
        "fewer: their gain is over those). Saved: updates that clamping takes away, of unclamped "
        "ones. Last: our updates over theirs. Steiner (2006) reports a gain of 8 to 10 %; what "
        "whole objects gain hangs on how a model is cut into objects, above all its ground."
    )
    yield ""
    head = ["altitude", "ours, gain", "saved", "whole receivers, gain", "saved",
            "whole casters too, gain", "saved", "ours over the former", "the latter"]  # fmt: skip
    rows = []
    for t in tight:
        ours = t.updates[CLAMPED].total
        theirs, both = t.updates[WHOLE_OBJECTS].total, t.updates[ALL_WHOLE_OBJECTS].total
        rows.append(
            (
                f"{t.altitude_deg:g}", _number(t.gain()), _saved(t, CLAMPED, UNCLAMPED),
                _number(t.gain(WHOLE_OBJECTS)), _saved(t, WHOLE_OBJECTS, UNCLAMPED),
                _number(t.gain(ALL_WHOLE_OBJECTS)), _saved(t, ALL_WHOLE_OBJECTS, ALL_UNCLAMPED),
                f"{ours / max(theirs, 1):.2f}", f"{ours / max(both, 1):.2f}",
            )
        )  # fmt: skip
    yield from table(head, rows)


def _saved(t: Tight, name: str, whole: str) -> str:
    return f"{1.0 - t.updates[name].total / max(t.updates[whole].total, 1):.1%}"


def _areas(tight: Sequence[Tight]) -> Iterator[str]:
    yield (
        "The same by the surface of all volumes, seen or not (`ClampTable.facts`; unclamped ones "
        "end with the scene):"
    )
    yield ""
    rows = [
        (
            f"{t.altitude_deg:g}", _number(t.area_gain), _number(t.area_gain_own),
            f"{t.area_gain / t.area_gain_own:.3f}",
        )
        for t in tight
    ]  # fmt: skip
    yield from table(["altitude", "gain", "own box", "share"], rows)


def models(listed: Sequence[ModelFigures], n_pixels: int) -> Iterator[str]:
    """Yield a row a model: share of the own boxes' gain, and gains.

    Parameters
    ----------
    n_pixels : int
        Of all views of a model: one that fewer than a tenth of them see is left out.
    """
    altitudes = [f"{t.altitude_deg:g}" for t in listed[0].tight]
    seen = [model for model in listed if 10 * sum(model.tight[0].pixels) >= n_pixels]
    yield (
        "Share of the own boxes' gain, by altitude of the sun; then the share with faces cut to "
        "the rectangle; then the share at the floor:"
    )
    yield ""
    rows = [
        (
            model.name, f"{model.triangles:,}", f"{model.casters:,}",
            *(f"{t.share_of_own_box:.2f}" for t in model.tight),
            *(f"{t.gain(CUT_FACES) / t.gain(OWN_BOX):.2f}" for t in model.tight),
            *(f"{t.most_share:.2f}" for t in model.tight),
        )
        for model in seen
    ]  # fmt: skip
    cut = [f"cut, {altitude}" for altitude in altitudes]
    floors = [f"floor, {altitude}" for altitude in altitudes]
    yield from table(["model", "triangles", "casters", *altitudes, *cut, *floors], rows)
    yield ""
    costlier = sum(t.n_costlier_views for model in listed for t in model.tight)
    n_views = len(VIEWS) * sum(len(model.tight) for model in listed)
    yield f"Views in which clamped volumes cost more than unclamped ones: {costlier} of {n_views}."
    if len(seen) < len(listed):
        few = [model.name for model in listed if model not in seen]
        yield (
            "Left out here and in the next table, because fewer than a tenth of the pixels see "
            f"anything of them (they fill a small part of their bounds): {', '.join(few)}."
        )
    yield ""
    yield "Gain in updates: clamped / own box alone / whole objects as receivers:"
    yield ""
    rows = [
        (
            model.name,
            *(
                f"{_number(t.gain())} / {_number(t.gain(OWN_BOX))} / "
                f"{_number(t.gain(WHOLE_OBJECTS))}"
                for t in model.tight
            ),
        )
        for model in seen
    ]
    yield from table(["model", *altitudes], rows)
    yield ""
    yield "Gain in surface: clamped / own box alone:"
    yield ""
    rows = [
        (
            model.name,
            *(f"{_number(t.area_gain)} / {_number(t.area_gain_own)}" for t in model.tight),
        )
        for model in listed
    ]
    yield from table(["model", *altitudes], rows)


def cost_rows(tight: Sequence[Tight]) -> Iterator[str]:
    """Yield what the cost of a vertex changes; the area's is 1."""
    yield (
        "The generated city. Only the ratio of the costs of a vertex and of a square metre "
        "matters; that of the area is 1, and the product's usual cost of a vertex 4. Updates: of "
        "all views, over those of the usual cost."
    )
    yield ""
    head = ["altitude", "vertex", "segments/caster", "with a slanted end", "with gaps",
            "bytes/caster", "updates"]  # fmt: skip
    rows = [
        (
            f"{t.altitude_deg:g}", f"{cost:g}", f"{row.segments:.3f}", f"{row.slanted:.1%}",
            f"{row.gaps:.1%}", f"{row.n_bytes:.1f}",
            f"{row.updates / max(t.updates[CLAMPED].total, 1):.3f}",
        )
        for t in tight
        for cost, row in t.costs.items()
    ]  # fmt: skip
    yield from table(head, rows)


def _number(value: float) -> str:
    """Return about three significant digits."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"

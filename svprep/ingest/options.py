"""What of the input files is wanted."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from svprep.errors import InputError
from svprep.ingest.crs_names import is_place_on_earth

HIGHEST: Final = "highest"
_LOD: Final = re.compile(r"[0-9]{1,3}(\.[0-9]{1,3})?")


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What readers leave out, as far as their format tells it apart."""

    lod: str = HIGHEST
    """Level of detail: of each building with its parts the highest that it has, or the one
    of this name (``"2"``, ``"2.2"``). LoD 0 only if it is named."""
    objects: tuple[str, ...] = ()
    """Only objects of these types; all if empty. ``"Building"`` also takes ``"BuildingPart"``."""
    has_terrain: bool = True
    has_openings: bool = True
    """Windows and doors."""
    crs: str = ""
    """Of files that state none, or one that pyproj does not know; see `svprep.ingest.crs_given`."""

    def __post_init__(self) -> None:
        if not is_lod(self.lod):
            raise InputError(
                f'the level of detail is "{HIGHEST}" or a number such as 2 or 2.2, not "{self.lod}"'
            )
        if self.crs and not is_place_on_earth(self.crs):
            raise InputError(
                "the CRS of the input files is one on Earth that pyproj knows, such as "
                f'EPSG:28992, not "{self.crs}"'
            )

    def as_config(self) -> dict[str, object]:
        """Return what differs from the defaults, as JSON values; the order of types is one."""
        config: dict[str, object] = {}
        if self.lod != HIGHEST:
            config["lod"] = self.lod
        if self.objects:
            once = {name.casefold(): name for name in reversed(self.objects)}
            config["objects"] = [once[key] for key in sorted(once)]
        if not self.has_terrain:
            config["terrain"] = False
        if not self.has_openings:
            config["openings"] = False
        if self.crs:
            config["crs"] = self.crs
        return config


def is_lod(text: str) -> bool:
    """Whether `text` names a level of detail, or the highest."""
    return text == HIGHEST or _LOD.fullmatch(text) is not None

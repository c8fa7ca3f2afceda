"""Which code made the tables that a later build takes over.

A version number would do for releases. Whoever changes a stage builds twice with the same
version, though, and must not be given yesterday's tables.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Final

from svprep import __version__

_PARTS: Final = (
    "clamp*.py",
    "content.py",
    "edges.py",
    "hilbert.py",
    "model.py",
    "planes.py",
    "ranges.py",
    "scene_tree.py",
    "tiles.py",
    "cache/codec.py",
    "cache/runs.py",
    "cache/schema.py",
    "kernels/*.py",
    "repair/*.py",
    "silhouette/index.py",
    "silhouette/trees.py",
)


@cache
def stage_code() -> str:
    """Return the SHA-256, in hex, of the version and of the sources of all that makes tables.

    Of the version alone where there are no sources to read. A millisecond or two.
    """
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(__version__.encode())
    for pattern in _PARTS:
        for path in sorted(root.glob(pattern)):
            text = path.read_bytes()
            digest.update(f"\n{path.name} {len(text)}\n".encode())
            digest.update(text)
    return digest.hexdigest()

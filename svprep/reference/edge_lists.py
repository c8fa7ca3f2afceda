"""Twins of the two queries that walk over faces: edge elimination and the edge buffer.

Both look at every face once and at no edge record's two faces together, so they
reach the multiplicities by another way. For small meshes: plain Python.

    rows             ``(n_edges, 4)``: edge records ``[v0, v1, left, right]``
    facing           ``(n_faces,)`` in {-1, 0, +1}, by plane record
    is_closed_face   ``(n_faces,)``: whether each face's component takes the closed volume
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from svprep.model import NO_INDEX

UP, DOWN = 1, -1
"""A face runs v0 -> v1 along a record, or v1 -> v0."""


def eliminate_edges(
    rows: np.ndarray, facing: np.ndarray, is_closed_face: np.ndarray
) -> dict[int, int]:
    """Return ``{edge id: m}`` of the silhouette by edge elimination.

    Each face that counts puts its directed edges on a list, turned round with
    the face where it is turned away from the light (robust volume). An edge that
    finds its reverse on the list eliminates it; what stays is silhouette.

    Notes
    -----
    Steiner (2006). Edges are those of records, so that faces meet only in
    their pairs; one stays twice where a lit face and one turned round put it
    there in the same direction.
    """
    listed: Counter[tuple[int, int]] = Counter()
    for edges, s, is_closed in zip(
        _edges_of_faces(rows, len(facing)), facing.tolist(), is_closed_face.tolist(), strict=True
    ):
        if s == 0 or (is_closed and s < 0):
            continue
        for edge, way in edges:
            if listed[edge, -s * way] > 0:
                listed[edge, -s * way] -= 1
            else:
                listed[edge, s * way] += 1
    return {edge: way * times for (edge, way), times in sorted(listed.items()) if times}


def edge_buffer(rows: np.ndarray, facing: np.ndarray, is_closed_face: np.ndarray) -> dict[int, int]:
    """Return ``{edge id: m}`` of the silhouette by the edge buffer.

    Each edge has a front and a back bit, which its faces turn by exclusive or. Two
    more bits are turned by faces on the left only and say which way the side runs.

    Notes
    -----
    Buchanan and Sousa (2000), "The edge buffer: a data structure for easy
    silhouette rendering"; the direction bits are ours.
    """
    front, back, left_front, left_back = ([False] * len(rows) for _ in range(4))
    for edges, s in zip(_edges_of_faces(rows, len(facing)), facing.tolist(), strict=True):
        for edge, way in edges:
            if s > 0:
                front[edge] ^= True
                left_front[edge] ^= way == UP
            elif s < 0:
                back[edge] ^= True
                left_back[edge] ^= way == UP
    found = {}
    for edge, (_, _, left, right) in enumerate(rows.tolist()):
        m = 0
        if front[edge]:
            m += 1 if left_front[edge] else -1
        if back[edge] and not is_closed_face[left if left != NO_INDEX else right]:
            m += -1 if left_back[edge] else 1
        if m:
            found[edge] = m
    return found


def _edges_of_faces(rows: np.ndarray, n_faces: int) -> list[list[tuple[int, int]]]:
    """Return ``(edge id, UP or DOWN)`` of the three sides of each face."""
    edges: list[list[tuple[int, int]]] = [[] for _ in range(n_faces)]
    for edge, (_, _, left, right) in enumerate(rows.tolist()):
        if left != NO_INDEX:
            edges[left].append((edge, UP))
        if right != NO_INDEX:
            edges[right].append((edge, DOWN))
    return edges

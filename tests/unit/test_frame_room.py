"""Calls that cross the end of a chunk of frames have nothing mapped and unmapped."""

from __future__ import annotations

import resource

from svprep.frame_room import with_room_for_frames


def _small() -> None:
    pass


def _faults_at_each_depth(most: int) -> list[int]:
    """Return the page faults of a thousand calls, made with 0 .. `most` frames below."""
    found = []

    def go(depth: int) -> None:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        for _ in range(1000):
            _small()
        found.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
        if depth < most:
            go(depth + 1)

    go(0)
    return found


@with_room_for_frames
def _with_room(most: int) -> list[int]:
    return _faults_at_each_depth(most)


def test_no_depth_of_calls_maps_memory_again_and_again() -> None:
    assert max(_with_room(400)) < 500

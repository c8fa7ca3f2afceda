"""What of a cache lies in graphics memory, under a budget of bytes.

binding    buffer          of
0          positions       scene    x y z float32, 12 bytes a vertex
1          corners         scene    uint32, 12 bytes a face
2          edge vertices   scene    uint32, 8 bytes an edge record
3          facing          light    int8 a face, four a word
4          segments        light    near, far, two slopes: 16 bytes
5          entries         light    what to draw of the volumes: 8 bytes each
6          tally           frame    negative pixels, highest count, farthest shift
7          neighbours      scene    uint32, 12 bytes a face (geometry shader only)
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from svprep.errors import EnvironmentProblem
from svprep_runtime.context import Context

if TYPE_CHECKING:
    import moderngl

POSITIONS: Final = 0
CORNERS: Final = 1
EDGE_VERTICES: Final = 2
FACING: Final = 3
SEGMENTS: Final = 4
ENTRIES: Final = 5
TALLY: Final = 6
NEIGHBOURS: Final = 7

DEFAULT_BUDGET_BYTES: Final = 4 << 30


@dataclass(slots=True)
class Memory:
    """Buffers of one context, counted against a budget."""

    context: Context
    budget_bytes: int = DEFAULT_BUDGET_BYTES
    used_bytes: int = 0
    _buffers: dict[int, moderngl.Buffer] = field(default_factory=dict)

    def upload(self, array: np.ndarray, what: str) -> moderngl.Buffer:
        """Return a buffer that holds `array`.

        Raises
        ------
        EnvironmentProblem
            It does not fit the budget, or what the driver allows for one buffer.
        """
        n_bytes = max((array.nbytes + 15) // 16 * 16, 16)
        if n_bytes > self.context.most_buffer_bytes:
            raise EnvironmentProblem(
                f"{what} take {n_bytes:,} bytes; this driver allows "
                f"{self.context.most_buffer_bytes:,} in one buffer. Build parts of the model apart"
            )
        if self.used_bytes + n_bytes > self.budget_bytes:
            raise EnvironmentProblem(
                f"{what} take {n_bytes:,} bytes more, {self.used_bytes + n_bytes:,} in all; "
                f"the budget is {self.budget_bytes:,}. Raise it with --memory, or build parts "
                "of the model apart"
            )
        buffer = self.context.ctx.buffer(reserve=n_bytes)
        if array.nbytes:
            buffer.write(np.ascontiguousarray(array).view(np.uint8).reshape(-1))
        self.used_bytes += n_bytes
        self._buffers[buffer.glo] = buffer
        return buffer

    def free(self, buffer: moderngl.Buffer) -> None:
        """Give one buffer back."""
        self.used_bytes -= buffer.size
        del self._buffers[buffer.glo]
        buffer.release()

    def release(self) -> None:
        """Give all back."""
        for buffer in list(self._buffers.values()):
            self.free(buffer)

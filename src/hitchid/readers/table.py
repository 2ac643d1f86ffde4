"""What every reader hands over: named columns of numbers."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Table:
    """Columns of one log as they stand in the file.

    Attributes:
        source: the file.
        columns: name to numbers, each of shape [N].
        lines: line of each sample, shape [N], None where the format has no lines.
    """

    source: Path
    columns: Mapping[str, np.ndarray]
    lines: np.ndarray | None = None

    def line_of(self, row: int) -> int | None:
        """Return the line a sample stands on, None where the format has no lines."""
        return None if self.lines is None else int(self.lines[row])

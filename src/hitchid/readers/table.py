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
        first_line: line of the first sample, None where the format has no lines.
    """

    source: Path
    columns: Mapping[str, np.ndarray]
    first_line: int | None = None

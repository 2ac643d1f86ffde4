"""Arrays as nested tuples, which templates write as arrays of C."""

from typing import Any

import numpy as np

Rows = tuple[Any, ...]  # nested tuples of numbers


def rows(array: object) -> Rows:
    """Return an array as nested tuples."""
    nested = np.asarray(array).tolist()

    def frozen(part: object) -> object:
        return tuple(frozen(each) for each in part) if isinstance(part, list) else part

    result = frozen(nested)
    return result if isinstance(result, tuple) else (result,)

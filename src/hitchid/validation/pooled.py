"""Figures of predictions, pooled over tests, as JSON can hold them."""

from collections.abc import Sequence

import numpy as np

from hitchid._support.metrics import error_figures, rmse_error


def pooled(actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> dict[str, float | None]:
    """Return `error_figures` and the standard error of the RMSE; None for what is not finite.

    Args:
        actual, predicted: displacement, one array of shape [N_i] for each test.
    """
    figures = {**error_figures(actual, predicted)._asdict(), "rmse_error": rmse_error(actual, predicted)}
    return {name: value if np.isfinite(value) else None for name, value in figures.items()}

"""Many tests at once: adjusted p-values whose false discovery rate is controlled."""

import numpy as np
from jaxtyping import Float


def adjusted_p_values(p_values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the smallest false discovery rate at which each test is a discovery.

    With p₍₁₎ ≤ … ≤ p₍ₘ₎: q₍ᵢ₎ = min over j ≥ i of m p₍ⱼ₎/j.

    Args:
        p_values: of all tests, of any shape; NaN where there is no test, which is not counted.

    Returns:
        Adjusted p-values, of the same shape; NaN where there is no test.

    Source: Benjamini & Hochberg 1995, Controlling the false discovery rate.
    """
    adjusted = np.full(p_values.shape, np.nan)
    tested = np.flatnonzero(~np.isnan(p_values))
    order = tested[np.argsort(p_values.flat[tested], kind="stable")]
    rates = p_values.flat[order] * tested.size / np.arange(1, tested.size + 1)
    adjusted.flat[order] = np.minimum(1.0, np.minimum.accumulate(rates[::-1])[::-1])
    return adjusted

"""Test whether two independent groups of tests have the same parameters."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from hitchid.model.provenance import DifferenceTest
from hitchid.uncertainty.scores import Scores

MIN_RELATIVE_VARIANCE = 1e-14  # smallest eigenvalue of C over its largest: below it C is singular to rounding
MIN_DENOMINATOR_DEGREES = 1.0  # fewest degrees of freedom of the denominator of F; chosen


def difference_test(
    difference: Float[np.ndarray, " p"], one: Scores, other: Scores, names: Sequence[str]
) -> DifferenceTest | None:
    """Test the difference of the estimates of two groups of tests by Hotelling's statistic.

    W = dᵀ C⁻¹ d with C = C₁ + C₂, the cluster-robust covariances of the two groups (`Scores.influence`):
    tests are independent, the samples of one test need not be. (ν − p + 1)/(ν p) W is compared with F at p
    and ν − p + 1 degrees of freedom. The covariances differ, so that (Krishnamoorthy & Yu 2004, Statist.
    Probab. Lett. 66, 161)

        ν = (p + p²) / Σᵢ (tr((Cᵢ C⁻¹)²) + (tr(Cᵢ C⁻¹))²)/νᵢ

    with νᵢ the mean of the degrees of freedom of group i over the p uncorrelated combinations C^(−½) d.

    Args:
        difference: of the estimates d, in the unit cube.
        one, other: scores of the two groups at their estimates, over the parameters compared.
        names: of these parameters.

    Returns:
        The test; None where the degrees of freedom do not suffice, and where C is singular.
    """
    parameters = difference.size
    covariances = [influence.T @ influence for influence in (one.influence(), other.influence())]
    variances, vectors = np.linalg.eigh(sum(covariances))
    if not variances[0] > MIN_RELATIVE_VARIANCE * variances[-1]:
        return None
    whitening = vectors / np.sqrt(variances)
    shares = [whitening.T @ covariance @ whitening for covariance in covariances]
    group_degrees = [float(scores.degrees_of_freedom(whitening).mean()) for scores in (one, other)]
    degrees = (parameters + parameters**2) / sum(
        (float(np.sum(share**2)) + float(np.trace(share)) ** 2) / group
        for share, group in zip(shares, group_degrees, strict=True)
    )
    denominator = degrees - parameters + 1
    if denominator < MIN_DENOMINATOR_DEGREES:
        return None
    statistic = denominator / (degrees * parameters) * float(np.sum((difference @ whitening) ** 2))
    p_value = float(fdtrc(parameters, denominator, statistic))
    return DifferenceTest(statistic, tuple(names), denominator, p_value)

"""Fisher information of the identification tests, with correlated errors: the record."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Information:
    """Fisher information of the identification tests about the parameters that do not lie at a bound.

    Parameters are positions between the bounds of the search, 0 the lower and 1 the upper one.

    Attributes:
        names: names of these parameters.
        slopes: dθ/dposition of each.
        curvature: H = Σ Jₜᵀ Jₜ.
        score_covariance: S = Σ gₜ gₜᵀ over tests; the covariance of the estimates is H⁻¹ S H⁻¹.
        dead_zone_covariance: what the error of the dead zone adds to it, independent of the number of tests.
        autocovariance: of the errors, at multiples of the block size.
        block_size: samples between two lags of the autocovariance.
        per_test_gain: whether the fit had a gain factor for each test, which takes up information.
        tests, samples: number of tests, and samples in the mean one.
    """

    names: tuple[str, ...]
    slopes: tuple[float, ...]
    curvature: tuple[tuple[float, ...], ...]
    score_covariance: tuple[tuple[float, ...], ...]
    dead_zone_covariance: tuple[tuple[float, ...], ...]
    autocovariance: tuple[float, ...]
    block_size: int
    per_test_gain: bool
    tests: int
    samples: float

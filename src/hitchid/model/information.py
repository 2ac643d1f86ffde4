"""Record of the Fisher information of the identification tests, for correlated errors."""

from dataclasses import dataclass

from hitchid._support.short_repr import short_repr


@short_repr
@dataclass(frozen=True)
class Information:
    """Fisher information of the identification tests, for the parameters that are not at a bound.

    Parameters are scaled to positions between the bounds of the search, 0 the lower and 1 the upper one.

    Attributes:
        names: names of these parameters.
        slopes: dθ/dposition of each parameter.
        curvature: H = Σ Jₜᵀ Jₜ.
        score_covariance: S = Σ gₜ gₜᵀ over tests; the covariance of the estimates is H⁻¹ S H⁻¹.
        dead_zone_covariance: added to it for the error of the dead zone; independent of the number of tests.
        autocovariance: autocovariance of the errors at multiples of the block size.
        block_size: samples between two lags of the autocovariance.
        per_test_gain: whether the fit had a gain factor for each test, which reduces the information.
        tests, samples: number of tests, and mean number of samples of a test.
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

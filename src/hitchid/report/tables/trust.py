"""Tables of prediction bands and residual tests."""

from collections.abc import Mapping

from hitchid.report import numbers
from hitchid.report.document import Table
from hitchid.validation import BandFigures
from hitchid.validation.names import RUNS
from hitchid.validation.residuals import ResidualTests


def band_table(direction: str, bands: BandFigures, unit: str) -> Table:
    """Return the share of unseen samples inside the bands, in free run and over horizons."""
    rows = [("free run", *_coverage_cells(bands.covered, bands.width))]
    if bands.horizons is not None:
        horizons = zip(bands.horizons.steps, bands.horizons.covered, bands.horizons.width, strict=True)
        rows += [
            (f"{numbers.count(step, 'sample')} ahead", *_coverage_cells(covered, width))
            for step, covered, width in horizons
        ]
    header = ("prediction", "covered / %", f"mean width / {unit}")
    level = numbers.percent(bands.coverage, 0)
    return Table(f"{direction}: band for {level} % of the samples of an unseen test", header, tuple(rows))


def _coverage_cells(share: float, width: float) -> tuple[str, str]:
    return numbers.percent(share), numbers.digits(width)


def residual_table(direction: str, residuals: Mapping[str, ResidualTests | None], unit: str) -> Table:
    """Return the tests of the errors, one step ahead and in free run."""
    header = (
        "errors",
        f"mean ± std / {unit}",
        "white",
        "independent of the command",
        "normal",
        "explained by position / %",
        "by speed / %",
        "by command / %",
        f"largest RMSE / {unit}",
    )
    rows = tuple((RUNS[run], *_residual_cells(tests, len(header) - 1)) for run, tests in residuals.items())
    return Table(f"{direction}: tests of the errors, level 1 %", header, rows)


def _residual_cells(tests: ResidualTests | None, count: int) -> tuple[str, ...]:
    if tests is None:
        return (numbers.DIVERGED, *[""] * (count - 1))
    quantity, worst = max(
        ((name, error_bin) for name, group in tests.by_quantity.items() for error_bin in group.bins),
        key=lambda pair: pair[1].rmse,
    )
    return (
        f"{tests.mean:.3g} ± {tests.deviation:.3g}",
        _decision(tests.white, tests.whiteness_p),
        _decision(tests.independent, tests.independence_p),
        _decision(tests.normal, tests.normality_p),
        *(numbers.percent(group.share, 0) for group in tests.by_quantity.values()),
        f"{quantity} {worst.lower:.3g} … {worst.upper:.3g}: {worst.rmse:.3g}",
    )


def _decision(passed: bool, probability: float) -> str:
    return f"{'yes' if passed else 'no'}, {numbers.p_value(probability)}"

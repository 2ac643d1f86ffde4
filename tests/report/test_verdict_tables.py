"""The verdict of a validation says what its tables say: fifty results drawn at random, their tables read."""

import re
from dataclasses import replace

import numpy as np
import pytest

import reported
import validated
from hitchid.logs.record import LIFTING
from hitchid.report import Rating
from hitchid.report.validation_report import all_tables
from hitchid.report.verdict import uses_section, verdict_section
from hitchid.validation import Accuracy, ModelFigures, RunFigures
from hitchid.validation.results import figures_by_test

WORST_FIRST = [Rating.BAD, Rating.CAUTION, Rating.GOOD]
RIVALS = ("narx", "arx", "lstm")


def drawn(seed):
    """Return a validation of lifting whose models err by anything from far too much to next to nothing."""
    rng = np.random.default_rng(seed)
    tests = reported.predictions(sizes=(120,) * int(rng.integers(1, 7)), seed=seed)
    size = dict(zip(tests.models, 10 ** rng.uniform(-1.5, 1.7, len(tests.models)), strict=True))
    if rng.random() < 0.3:
        size["free_run"] = size["benchmark"]
    rows = {
        name: tuple(y + scale * rng.uniform(0.5, 2.0) * np.sin(np.arange(y.size) / 7) for y in tests.actual)
        for name, scale in size.items()
    }
    rivals = [name for name in RIVALS if rng.random() < 0.5]
    if rng.random() < 0.1:
        rows["free_run"] = tuple(np.full(y.size, np.inf) for y in tests.actual)
    kept = ("benchmark", "free_run", "one_step", *rivals)
    tests = replace(tests, models={name: rows[name] for name in kept}, band=None)

    def figures(name):
        return RunFigures.of(tests.actual, rows[name])

    models = {
        "persistence": ModelFigures(one_step=figures("persistence")),
        **{name: ModelFigures(figures(name), figures(name)) for name in rivals},
        "benchmark": ModelFigures(free_run=figures("benchmark")),
        "greybox": ModelFigures(figures("one_step"), figures("free_run")),
    }
    ahead = {
        name: tuple(10 ** rng.uniform(-1, 0.3) * np.array(reported.STEPS) ** 0.5)
        for name in ("persistence", "benchmark", "greybox", *rivals)
    }
    if rng.random() < 0.3:
        ahead["greybox"] = tuple(0.5 * np.min(list(ahead.values()), axis=0))
    horizons = replace(reported.horizons(), rmse=ahead, rmse_error={})
    bands = reported.bands(covered=rng.uniform(0.4, 1.0), ahead=rng.uniform(0.4, 1.0))
    accuracy = Accuracy(models, horizons, figures_by_test(tests), tests, bands)
    parameters = [estimate for estimate in reported.ESTIMATES if rng.random() < 0.5]
    result = validated.validation()
    channel = replace(
        result.channels[LIFTING],
        accuracy=accuracy,
        parameters=reported.known_estimates(*parameters) if parameters else None,
    )
    return replace(result, channels={LIFTING: channel}, cycles=None)


def number(cell):
    """Return the value of a cell such as `0.46 ± 0.12`; infinite where a model diverged."""
    return np.inf if cell == "diverged" else float(cell.partition(" ")[0])


def figure(pattern, finding):
    """Return the number that a finding states."""
    return float(re.search(pattern, finding.sentence)[1])


@pytest.mark.parametrize("seed", range(50))
def test_the_verdict_follows_from_the_tables(seed):
    result = drawn(seed)
    tables = all_tables(result)
    findings = verdict_section(result, None)
    levels = [WORST_FIRST.index(finding.level) for finding in findings]
    assert levels == sorted(levels)

    def said(words):
        (finding,) = (finding for finding in findings if words in finding.sentence)
        return finding

    def read(title):
        (table,) = (table for table in tables if title in table.title)
        return table

    accuracy = read("lifting: accuracy on")
    (use,) = uses_section(result)
    free_runs = {row[0]: row for row in accuracy.rows if row[1] == "free run"}
    rmse = {name: number(row[2]) for name, row in free_runs.items()}
    own, fit = rmse["grey box"], number(free_runs["grey box"][5])
    free_run = said("ree run")
    count = len(read("test by test").rows)
    if not np.isfinite(own):
        assert (free_run.level, "diverged" in free_run.sentence) == (Rating.BAD, True)
        assert "not usable" in use
    else:
        # The sentence has three digits, the table those that its standard error leaves.
        assert figure(r"fit (\S+) %", free_run) == pytest.approx(fit, rel=0.01, abs=0.5)
        assert f"RMSE {free_runs['grey box'][2]} mm" in free_run.sentence
        assert f"{count} unseen test" in free_run.sentence
        assert ("not usable" in use, "rough" in use) == (fit < 50, 50 <= fit < 80)
        assert free_run.level is Rating.BAD or fit >= 50
        fits = {row[0]: number(row[4]) for row in read("test by test").rows}
        better = [name for name in rmse if name != "grey box" and rmse[name] < own]
        fine = fit >= 80 and not better and len(rmse) > 2 and count >= 3 and min(fits.values()) >= 50
        assert free_run.level is not Rating.GOOD or fine
        if "physics model" in better:
            assert "physics model alone errs less" in free_run.sentence
        rivals = {name: error for name, error in rmse.items() if name not in ("grey box", "physics model")}
        if rivals:
            assert f"best baseline: {min(rivals, key=lambda name: rivals[name])}" in free_run.sentence
        else:
            assert "no baseline" in free_run.sentence

    table = read("over the horizon")
    errors = {row[0]: np.array(list(map(number, row[1:]))) for row in table.rows}
    ratios = {name: errors["grey box"] / row for name, row in errors.items() if name != "grey box"}
    worst = max(ratios, key=lambda name: ratios[name].max())
    ahead = said("Lifting, ahead")
    if ratios[worst].max() > 1.06:
        assert f"{worst} errs less" in ahead.sentence
        assert ahead.level is (Rating.BAD if ratios[worst].max() > 1.5 else Rating.CAUTION)
    elif ratios[worst].max() < 1.04:
        assert ahead.level is (Rating.GOOD if count >= 3 else Rating.CAUTION)

    covered = [number(row[1]) for row in read("band for").rows]
    band = said("% band")
    assert figure(r"(\d+) % of samples", band) == pytest.approx(covered[0], abs=0.56)
    # The error of the free run's coverage over tests is 1 %; that of a single test is not known.
    if min(covered[1:]) < 69 or (covered[0] < 84 and count >= 3):
        assert band.level is Rating.BAD
    if min(covered) < 84 or covered[0] > 96:
        assert band.level is not Rating.GOOD

    if result.channels[LIFTING].parameters is not None:
        verdicts = [row[-1] for row in read("parameters of the physics model").rows]
        lacking = sum(verdict != "determined" for verdict in verdicts)
        parameters = said("determined")
        assert (parameters.level is Rating.GOOD) == (lacking == 0)
        words = f"{lacking} of {len(verdicts)} parameter" if lacking else f"{len(verdicts)} parameter"
        single = len(verdicts) == 1 and "the one parameter" in use
        assert words in use or single or "diverged" in use
    else:
        assert not [finding for finding in findings if "parameter" in finding.sentence]

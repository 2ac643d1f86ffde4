"""Acceptance: limits as files have them, verdicts by hand, and words that agree with them."""

import json
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.metrics import HORIZONS
from hitchid.errors import SettingsError
from hitchid.report.verdict import check_line
from hitchid.validation import Accuracy, BandFigures, Horizons, ModelFigures, Predictions, RunFigures
from hitchid.validation import check_limits as check_figures
from hitchid.validation.limits import BASELINES, AcceptanceLimits, read_limits

FILE = """
unit = "mm"

[lifting]
tests = 4
free_run = { rmse = 0.5, mae = 0.4, fit = 95, r2 = 0.99, max_abs = 2, within_1 = 95 }
one_step = { rmse = 0.2 }
worst_test = { rmse = 1.0 }
horizon = { 10 = 0.2, 100 = 0.5 }
coverage = [80, 97]
better_than = ["persistence", "transfer_function"]

[cycles]
free_run = { rmse = 3 }
"""

lengths = st.floats(1e-6, 1e6)
ratios = st.floats(-1e-3, 1e-3) | st.sampled_from([-3e-16, 0.0, 3e-16])


def figures(rmse=0.3, **others):
    return {"rmse": rmse, "mae": 0.2, "r2": 0.999, "fit": 97.5, "max_abs": 1.5, "within_1": 0.96, **others}


def direction():
    """Return figures of one direction that keep every limit of `FILE`."""
    return {
        "tests": ["up-1", "up-2", "up-3", "up-4"],
        "greybox": {"one_step": figures(0.1), "free_run": figures(0.3)},
        "benchmark": {"free_run": figures(0.6)},
        "baselines": {
            "persistence": {"one_step": figures(0.15)},
            "transfer_function": {"free_run": figures(0.9)},
        },
        "horizons": {"steps": [1, 10, 100], "greybox": [0.1, 0.15, 0.25], "persistence": [0.15, 1.5, 9.0]},
        "per_test": {f"up-{i}": {"free_run": figures(0.1 * i)} for i in (1, 2, 4, 3)},
        "bands": {"coverage": 0.9, "free_run": {"covered": 0.9, "width": 1.0}},
    }


def campaign(unit="mm"):
    cycles = {
        "tests": ["mixed"],
        "greybox": {"free_run": figures(2.0), "one_step": figures(0.1)},
        "benchmark": {"free_run": figures(4.0)},
        "persistence": {"one_step": figures(0.2)},
        "horizons": {"steps": [1, 10], "greybox": [0.1, 0.4], "persistence": [0.2, 2.0]},
        "per_test": {"mixed": {"free_run": figures(2.0)}},
    }
    return {"unit": unit, "channels": {"lifting": direction()}, "cycles": cycles}


def accuracy(section):
    """Return the record of one direction, or of the cycles."""
    models = {name: section[name] for name in section if name in BASELINES or name == "greybox"}
    horizons = {name: tuple(values) for name, values in section["horizons"].items() if name != "steps"}
    bands = section.get("bands")
    return Accuracy(
        models={
            name: ModelFigures(**{run: RunFigures(**row) for run, row in runs.items()})
            for name, runs in {**models, **section.get("baselines", {})}.items()
        },
        horizons=Horizons(tuple(section["horizons"]["steps"]), horizons),
        per_test={name: RunFigures(**runs["free_run"]) for name, runs in section["per_test"].items()},
        predictions=Predictions(tuple(section["tests"]), (), (), {}),
        bands=bands and BandFigures(bands["coverage"], bands["free_run"]["covered"], None, 1.0),
    )


def check_limits(metrics, limits):
    sections = metrics["channels"] | {"cycles": metrics["cycles"]}
    return check_figures(metrics["unit"], {name: accuracy(s) for name, s in sections.items()}, limits)


def limits_of(mode="lifting", unit="mm", **demanded):
    return AcceptanceLimits.model_validate({"unit": unit, mode: demanded})


def only(metrics, limits):
    """Return the one check that limits amount to."""
    (check,) = check_limits(metrics, limits).checks
    return check


def verdicts(metrics, limits):
    return {check.name: check.passed for check in check_limits(metrics, limits).checks}


@pytest.fixture
def read(tmp_path):
    def of(text):
        path = tmp_path / "limits.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_limits(path)

    return of


# The file.


def test_a_file_is_read_as_it_stands(read):
    limits = read(FILE)
    assert (limits.unit, list(limits.by_direction)) == ("mm", ["lifting", "cycles"])
    lifting = limits.by_direction["lifting"]
    assert lifting.tests == 4
    expected = {"rmse": 0.5, "mae": 0.4, "max_abs": 2.0, "r2": 0.99, "fit": 95.0, "within_1": 95.0}
    assert lifting.free_run.model_dump() == expected
    assert lifting.horizon == {10: 0.2, 100: 0.5}
    assert lifting.coverage == (80.0, 97.0)
    assert lifting.better_than == ("persistence", "transfer_function")
    assert limits.by_direction["cycles"].free_run.rmse == 3.0


def test_every_limit_of_a_file_gets_a_verdict(read):
    outcome = check_limits(campaign(), read(FILE))
    assert outcome.passed
    assert [check_line(check) for check in outcome.checks] == [
        "pass  lifting: unseen tests 4, required at least 4",
        "pass  lifting: one step, RMSE 0.1 mm, required at most 0.2 mm",
        "pass  lifting: free run, RMSE 0.3 mm, required at most 0.5 mm",
        "pass  lifting: free run, MAE 0.2 mm, required at most 0.4 mm",
        "pass  lifting: free run, max abs 1.5 mm, required at most 2 mm",
        "pass  lifting: free run, R² 0.999, required at least 0.99",
        "pass  lifting: free run, fit 97.5 %, required at least 95 %",
        "pass  lifting: free run, within 1 mm 96 %, required at least 95 %",
        "pass  lifting: worst test, RMSE 0.4 mm in up-4, required at most 1 mm",
        "pass  lifting: 10 samples ahead, RMSE 0.15 mm, required at most 0.2 mm",
        "pass  lifting: 100 samples ahead, RMSE 0.25 mm, required at most 0.5 mm",
        "pass  lifting: inside the 90 % band 90 %, required 80 to 97 %",
        "pass  lifting: one step vs persistence, RMSE 0.1 mm, required below 0.15 mm",
        "pass  lifting: free run vs transfer_function, RMSE 0.3 mm, required below 0.9 mm",
        "pass  cycles: free run, RMSE 2 mm, required at most 3 mm",
    ]
    assert all(len(check_line(check)) <= 80 for check in outcome.checks)
    assert len({check.name for check in outcome.checks}) == len(outcome.checks)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected at least one of lifting, lowering, cycles"),
        ("[lifting]", "key 'lifting': is empty; expected at least one of tests"),
        ("lifting.one_step = {}", "key 'lifting.one_step': is empty"),
        ("lifting.horizon = {}", "key 'lifting.horizon': is empty"),
        ("lifting.better_than = []", "key 'lifting.better_than': is empty"),
        ("raising.tests = 1", "key 'raising' is not known; expected one of unit, lifting"),
        ("lifting.tets = 1", "key 'lifting.tets' is not known; did you mean 'tests'"),
        ("lifting.free_run.rsme = 1", "rsme' is not known; did you mean 'rmse'"),
        ("lifting.tests = 0", "key 'lifting.tests': expected at least 1, got 0"),
        ("lifting.tests = 1.5", "key 'lifting.tests': expected a whole number, got 1.5"),
        ("lifting.tests = true", "key 'lifting.tests': expected a whole number, got true"),
        ("lifting.free_run = 1", "key 'lifting.free_run': expected a table, got 1"),
        ('lifting.free_run.mae = "1"', "mae': expected a number, got '1'"),
        ("lifting.free_run.mae = true", "mae': expected a number, got true"),
        ("lifting.free_run.mae = -1.5", "mae': expected a number above 0, got -1.5"),
        ("lifting.free_run.mae = nan", "mae': expected a finite number, got nan"),
        ("lifting.free_run.r2 = 99", "r2': expected at most 1, got 99"),
        ("lifting.free_run.fit = 101", "fit': expected at most 100, got 101"),
        ("lifting.free_run.within_1 = 101", "within_1': expected at most 100, got 101"),
        ("lifting.horizon = { 3 = 1 }", "'lifting.horizon': got '3' .*expected one of 1, 2, 5"),
        ("lifting.horizon = { 010 = 1 }", "'lifting.horizon': got '010'"),
        ("lifting.horizon = { 10 = 0 }", "horizon.10': expected a number above 0, got 0"),
        ("lifting.horizon = 10", "'lifting.horizon': expected a table, got 10"),
        ("lifting.coverage = 90", "'lifting.coverage': expected a list, got 90"),
        ("lifting.coverage = [90]", "'lifting.coverage.1': expected a value, got none"),
        ("lifting.coverage = [97, 80]", r"'lifting.coverage': got \[97.0, 80.0\], expected"),
        ("lifting.coverage = [0, 80]", "'lifting.coverage.0': expected a number above 0, got 0"),
        ("lifting.coverage = [80, 101]", "'lifting.coverage.1': expected at most 100, got 101"),
        ('lifting.better_than = ["greybox"]', "got 'greybox', expected one of persistence"),
        ('lifting.better_than = ["arx", "arx"]', "got arx, arx, expected each once"),
        ('lifting.better_than = "arx"', "'lifting.better_than': expected a list, got 'arx'"),
        *((f"lifting.worst_test.{key} = 0", rf"'lifting\.worst_test\.{key}'") for key in figures()),
    ],
)
def test_a_wrong_file_is_refused_with_its_key(read, text, message):
    with pytest.raises(SettingsError, match=rf"limits\.toml: .*{message}"):
        read(f'unit = "mm"\n{text}')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lifting.tests = 1", "key 'unit': expected a value, got none"),
        ('unit = "ell"\nlifting.tests = 1', "key 'unit': expected one of A, mA, .*got 'ell'"),
        ("unit = ", "is not valid TOML"),
        (b"unit = \xff", "cannot be read"),
    ],
)
def test_a_file_without_a_unit_or_toml_is_refused(read, text, message):
    with pytest.raises(SettingsError, match=rf"limits\.toml: .*{message}"):
        read(text)


def test_a_file_that_is_missing_or_a_folder_is_told(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(SettingsError, match=rf"{path.name}: cannot be read"):
            read_limits(path)


# Verdicts.


@pytest.mark.parametrize("mode", ["lifting", "cycles"])
@pytest.mark.parametrize("run", ["free_run", "one_step", "worst_test"])
@pytest.mark.parametrize(
    ("key", "at", "worse", "limit"),
    [
        ("rmse", 0.5, 0.50001, 0.5),
        ("mae", 0.5, 0.50001, 0.5),
        ("max_abs", 0.5, 0.50001, 0.5),
        ("r2", 0.99, 0.98999, 0.99),
        ("fit", 95.0, 94.999, 95),
        # 100 times the float next to 0.57 lies below 57.
        ("within_1", 0.57, 0.56999, 57),
    ],
)
def test_a_limit_holds_at_itself_and_fails_beyond(mode, run, key, at, worse, limit):
    for figure, passes in ((at, True), (worse, False), (None, False), (float("nan"), False)):
        metrics = campaign()
        section = metrics["cycles"] if mode == "cycles" else metrics["channels"][mode]
        if run == "worst_test":
            test = section["tests"][-1]
            best = {"r2": 1.0, "fit": 100.0, "within_1": 1.0}.get(key, 0.0)
            section["per_test"] = {name: {"free_run": figures(**{key: best})} for name in section["tests"]}
            section["per_test"][test]["free_run"][key] = figure
        else:
            section["greybox"][run][key] = figure
        check = only(metrics, limits_of(mode, **{run: {key: limit}}))
        assert (check.direction, check.passed) == (mode, passes)
        if figure is None or figure != figure:
            assert check.figure.startswith("diverged")


def test_the_worst_test_is_named_whatever_its_place():
    check = only(campaign(), limits_of(worst_test={"rmse": 0.35}))
    assert (check.passed, check.figure) == (False, "0.4 mm in up-4")
    metrics = campaign()
    metrics["channels"]["lifting"]["per_test"]["up-2"]["free_run"] = figures(None, r2=0.5)
    assert only(metrics, limits_of(worst_test={"rmse": 9})).figure == "diverged in up-2"
    assert only(metrics, limits_of(worst_test={"r2": 0.9})).figure == "0.5 in up-2"


@pytest.mark.parametrize(
    ("covered", "passes"), [(0.7999, False), (0.8, True), (0.9, True), (0.97, True), (0.9701, False)]
)
def test_coverage_is_bounded_on_both_sides(covered, passes):
    metrics = campaign()
    metrics["channels"]["lifting"]["bands"]["free_run"]["covered"] = covered
    assert only(metrics, limits_of(coverage=[80, 97])).passed == passes


def test_better_means_a_lower_rmse_in_every_run_of_both():
    assert verdicts(campaign(), limits_of("cycles", better_than=["benchmark", "persistence"])) == {
        "cycles: free run vs benchmark, RMSE": True,
        "cycles: one step vs persistence, RMSE": True,
    }
    metrics = campaign()
    metrics["channels"]["lifting"]["baselines"]["arx"] = {"one_step": figures(0.1), "free_run": figures(0.31)}
    limits = limits_of(better_than=["arx", "benchmark"])
    assert verdicts(metrics, limits) == {
        "lifting: one step vs arx, RMSE": False,
        "lifting: free run vs arx, RMSE": True,
        "lifting: free run vs benchmark, RMSE": True,
    }


@pytest.mark.parametrize("ours", [0.3, None])
def test_what_diverged_is_nothing_to_be_better_than(ours):
    metrics = campaign()
    metrics["channels"]["lifting"]["greybox"]["free_run"] = figures(ours)
    metrics["channels"]["lifting"]["benchmark"]["free_run"] = figures(None)
    check = only(metrics, limits_of(better_than=["benchmark"]))
    assert not check.passed
    assert "diverged" in check.figure
    assert ("benchmark" in check.figure) == (ours is not None)


TOO_SHORT = "missing: the tests are too short; the longest horizon they allow"
NOT_IN_COMMON = "missing: no run (one step or free run) that the grey box and the baseline have in common"


@pytest.mark.parametrize(
    ("mode", "demanded", "figure"),
    [
        ("lowering", {"tests": 1}, "0"),
        ("lowering", {"free_run": {"rmse": 9}}, "missing: no unseen test"),
        ("lowering", {"worst_test": {"rmse": 9}}, "missing: no unseen test"),
        ("lowering", {"horizon": {"10": 9}}, "missing: no unseen test"),
        ("lowering", {"coverage": [1, 100]}, "missing: no unseen test"),
        ("lowering", {"better_than": ["arx"]}, "missing: no unseen test"),
        ("lifting", {"horizon": {"50": 9}}, f"{TOO_SHORT} is 10 samples"),
        ("lifting", {"better_than": ["arx"]}, "missing: no such baseline"),
        ("lifting", {"better_than": ["lstm"]}, NOT_IN_COMMON),
        ("lifting", {"one_step": {"rmse": 9}}, "missing: no one step"),
        ("cycles", {"coverage": [1, 100]}, "missing: no bands"),
    ],
)
def test_what_is_missing_fails_and_is_named(mode, demanded, figure):
    metrics = campaign()
    lifting = metrics["channels"]["lifting"]
    lifting["horizons"] = {"steps": [1, 10], "greybox": [0.1, 0.2]}
    lifting["baselines"]["lstm"] = {"one_step": figures(9.0)}
    del lifting["greybox"]["one_step"]
    check = only(metrics, limits_of(mode, **demanded))
    assert (check.direction, check.figure, check.passed) == (mode, figure, False)


def test_one_failed_check_fails_the_whole():
    outcome = check_limits(campaign(), limits_of(free_run={"rmse": 0.2, "mae": 0.4}))
    keys = ("mode", "name", "limit", "found", "passed")
    rows = (
        ("lifting", "lifting: free run, RMSE", "at most 0.2 mm", "0.3 mm", False),
        ("lifting", "lifting: free run, MAE", "at most 0.4 mm", "0.2 mm", True),
    )
    checks = [dict(zip(keys, row, strict=True)) for row in rows]
    assert json.loads(json.dumps(outcome.describe())) == {"passed": False, "checks": checks}


# Units.


@pytest.mark.parametrize(
    ("logs", "figure", "limits", "at", "below"),
    [
        ("m", 0.0003, "mm", 0.3, 0.2999),
        ("mm", 0.3, "m", 0.0003, 0.0002999),
        ("in", 1.0, "mm", 25.4, 25.399),
        ("mm", 25.4, "in", 1.0, 0.999),
        ("1", 0.03, "percent", 3.0, 2.99),
    ],
)
def test_errors_are_converted_to_the_unit_of_the_limits(logs, figure, limits, at, below):
    metrics = campaign(logs)
    lifting = metrics["channels"]["lifting"]
    lifting["greybox"] = {"one_step": figures(figure), "free_run": figures(figure)}
    lifting["horizons"] = {"steps": [10], "greybox": [figure]}
    lifting["per_test"] = {"up-1": {"free_run": figures(figure)}}
    for limit, passes in ((at, True), (below, False)):
        run = {"rmse": limit}
        demanded = {"free_run": run, "one_step": run, "worst_test": run, "horizon": {"10": limit}}
        checks = check_limits(metrics, limits_of(unit=limits, **demanded)).checks
        assert [check.passed for check in checks] == [passes] * 4
        assert all(Fraction(check.figure.split()[0]) == Fraction(str(at)) for check in checks)


def test_shares_are_not_converted_and_errors_of_baselines_are():
    demanded = {"free_run": {"r2": 0.999, "fit": 97.5}, "coverage": [90, 90], "tests": 4}
    assert check_limits(campaign("mm"), limits_of(unit="m", **demanded)).passed
    check = only(campaign("mm"), limits_of(unit="m", better_than=["benchmark"]))
    assert (check.figure, check.limit, check.passed) == ("0.0003 m", "below 0.0006 m", True)


def test_a_unit_of_another_dimension_is_refused():
    limits = limits_of(free_run={"rmse": 1})
    with pytest.raises(SettingsError, match=r"limits: key 'unit': 'mm'.*'deg'"):
        check_limits(campaign("deg"), limits)


@pytest.mark.parametrize("run", ["free_run", "one_step", "worst_test"])
def test_within_one_unit_is_not_converted(run):
    limits = limits_of(unit="cm", **{run: {"within_1": 90}})
    with pytest.raises(SettingsError, match=rf"'lifting\.{run}\.within_1': .*required unit = \"mm\""):
        check_limits(campaign("mm"), limits)
    limits.check_convertible("cm")


# Words.


def number(text):
    """Return the number in a text like `at most 0.5 mm`."""
    return next(Fraction(word) for word in text.split() if word[0] in "-0123456789")


def checked(figure, limit, key="rmse", unit="mm"):
    metrics = campaign()
    metrics["channels"]["lifting"]["greybox"]["free_run"][key] = figure
    return only(metrics, limits_of(unit=unit, free_run={key: limit}))


def test_a_figure_just_beyond_has_enough_digits():
    check = checked(0.50004, 0.5)
    assert (check.figure, check.limit, check.passed) == ("0.50004 mm", "at most 0.5 mm", False)
    assert checked(0.50004, 0.6).figure == "0.500 mm"
    assert checked(0.5, 0.5).figure == "0.5 mm"


@given(limit=lengths, ratio=ratios, unit=st.sampled_from(["mm", "m", "cm", "in"]))
def test_words_never_contradict_a_limit_of_an_error(limit, ratio, unit):
    factor = {"mm": 1.0, "m": 1e3, "cm": 10.0, "in": 25.4}[unit]
    check = checked(limit * factor * (1 + ratio), limit, unit=unit)
    assert check.passed == (number(check.figure) <= number(check.limit))
    assert float(number(check.limit)) == limit
    # Beyond the rounding of the conversion.
    assert check.passed == (ratio <= 0) or abs(ratio) < 1e-12


@given(limit=st.floats(1e-3, 100), ratio=ratios)
def test_words_never_contradict_a_limit_of_a_share(limit, ratio):
    check = checked(limit * (1 + ratio) / 100, limit, "within_1")
    assert check.passed == (number(check.figure) >= number(check.limit))


@given(ours=lengths, ratio=ratios)
def test_words_never_contradict_a_comparison(ours, ratio):
    theirs = ours * (1 + ratio)
    metrics = campaign()
    metrics["channels"]["lifting"]["greybox"]["free_run"]["rmse"] = ours
    metrics["channels"]["lifting"]["benchmark"]["free_run"]["rmse"] = theirs
    check = only(metrics, limits_of(better_than=["benchmark"]))
    assert check.passed == (ours < theirs)
    assert check.passed == (number(check.figure) < number(check.limit))


runs = st.fixed_dictionaries(
    {},
    optional={
        **dict.fromkeys(("rmse", "mae", "max_abs"), lengths),
        "r2": st.floats(0.01, 1),
        **dict.fromkeys(("fit", "within_1"), st.floats(0.01, 100)),
    },
).filter(bool)
demands = st.fixed_dictionaries(
    {},
    optional={
        "tests": st.integers(1, 8),
        **dict.fromkeys(("free_run", "one_step", "worst_test"), runs),
        "horizon": st.dictionaries(st.sampled_from([str(h) for h in HORIZONS]), lengths, min_size=1),
        "coverage": st.tuples(st.floats(0.01, 100), st.floats(0.01, 100)).map(sorted),
    },
).filter(bool)
measured = st.none() | st.floats(0, 1e6)


@st.composite
def validated(draw):
    """Return metrics of lifting whose figures are whatever they like, diverged too."""
    metrics = campaign()
    lifting = metrics["channels"]["lifting"]
    run = st.fixed_dictionaries(dict.fromkeys(figures(), measured))
    lifting["greybox"] = {"one_step": draw(run), "free_run": draw(run)}
    lifting["per_test"] = {name: {"free_run": draw(run)} for name in lifting["tests"]}
    lifting["horizons"] = {"steps": [1, 10], "greybox": [draw(measured), draw(measured)]}
    lifting["bands"]["free_run"]["covered"] = draw(st.floats(0, 1))
    return metrics


@given(metrics=validated(), demanded=demands)
def test_nothing_passes_without_a_number(metrics, demanded):
    for check in check_limits(metrics, limits_of(**demanded)).checks:
        assert check.figure[0].isdigit() or not check.passed


def test_a_line_stays_one_line_whatever_a_log_is_called():
    metrics = campaign()
    metrics["channels"]["lifting"]["per_test"] = {"a\nb\x1b[31m\udcff\u2028é": {"free_run": figures(0.3)}}
    text = check_line(only(metrics, limits_of(worst_test={"rmse": 1})))
    assert text == "pass  lifting: worst test, RMSE 0.3 mm in a�b�[31m��é, required at most 1 mm"

"""Reports of made-up benches: a verdict true to the figures, and a section for what there is."""

import hashlib
import re
import shutil
import tomllib
from dataclasses import replace
from functools import partial
from html import escape

import equinox as eqx
import numpy as np
import pytest

import benches
import handmade
import reported
from hitchid._support.jax_setup import installed_versions
from hitchid.errors import InputError, OutputError
from hitchid.logs import read, write_table
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Provenance, Uncertainty
from hitchid.report import FIGURES, Pictures, Rating, Table, write_report
from hitchid.report.document import Findings
from hitchid.report.origin import logs_section, origin_section
from hitchid.report.verdict import limits_section, verdict_section
from hitchid.validation import ModelFigures, RunFigures, compare, read_limits, validate
from hitchid.validation.report_data import Origin, log_data

MODES = (LIFTING, LOWERING)
COMMAND = "hitchid validate 'my model' logs --out report"


def known(model, *modes, parameters=reported.ESTIMATES):
    """Return a model that tells its parameters, as one that was identified does."""
    told = {
        mode: replace(
            model.uncertainty.get(mode, Uncertainty(reported.known_estimates())),
            benchmark=reported.known_estimates(*parameters),
        )
        for mode in modes
    }
    return replace(model, uncertainty={**model.uncertainty, **told})


def diverging(model):
    """Return a model whose lifting diverges."""
    channel = model.channels[LIFTING]
    wild = eqx.tree_at(lambda c: c.benchmark.values, channel, channel.benchmark.values * np.inf)
    return replace(model, channels={**model.channels, LIFTING: wild})


PLAIN = handmade.hitch("integrator")
# The plant's own structure and time constant, so nothing made by hand is nearer to it.
RIGHT = handmade.hitch("integrator-first-order")
WHOLE = known(
    handmade.with_bands(handmade.hitch("integrator", compensated=True, baselines=True), *MODES), *MODES
)
PARTS = {
    "whole": WHOLE,
    "diverging": diverging(handmade.hitch("integrator", baselines=True)),
    "lifting alone": handmade.hitch("integrator", modes=(LIFTING,)),
}


@pytest.fixture(scope="module")
def logs(bench_folder, tmp_path_factory):
    """Return three tests of each direction and a cycle."""
    return benches.with_a_cycle(bench_folder, tmp_path_factory.mktemp("reports") / "logs")


@pytest.fixture(scope="module")
def campaign(logs):
    return read(logs)


@pytest.fixture(scope="module")
def validated(campaign):
    """Return a function that validates one of `PARTS`, once."""
    found = {}

    def run(name):
        if name not in found:
            with np.errstate(all="ignore"):
                found[name] = validate(PARTS[name], campaign)
        return found[name]

    return run


@pytest.fixture(scope="module")
def report(validated, campaign):
    """Return a function that reports on one of `PARTS`; the trace is that of an identification with all."""
    trace = dict.fromkeys(MODES, reported.trace())
    found = {}

    def make(name):
        if name not in found:
            told = {"trace": trace} if name == "whole" else {}
            found[name] = validated(name).report(command=COMMAND, **told)
        return found[name]

    return make


def blocks(section, kind):
    """Return every block of a kind in a section and those below it."""
    inside = [each for each in section.blocks if isinstance(each, kind)]
    return inside + [each for below in section.sections for each in blocks(below, kind)]


def titles(sections):
    return [each.title for each in sections]


def section(document, title):
    (found,) = (each for each in document.sections if each.title == title)
    return found


def findings(document, *words):
    """Return the findings of the verdict that say some words."""
    return [each for each in document.verdict if all(word in each.sentence for word in words)]


# --- what a report holds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARTS)
def test_every_figure_has_a_name_of_its_own_a_caption_and_words_for_who_cannot_see_it(report, name):
    pictures = list(report(name).pictures)
    names = [each.name for each in pictures]
    assert len(names) == len(set(names)) > 5
    for each in pictures:
        assert re.fullmatch(r"[a-z]+(-[a-z]+)*", each.name)
        assert min(len(each.caption), len(each.alt)) > 20
        assert each.wide == (each.figure.get_figwidth() > 4)


@pytest.mark.parametrize("name", ["whole", "diverging"])
def test_no_figure_is_drawn_with_a_warning(report, name, recwarn):
    for each in report(name).pictures:
        assert "<svg" in each.svg
    assert not [str(each.message) for each in recwarn]


@pytest.mark.parametrize("name", PARTS)
def test_every_table_has_a_title_and_rows_as_long_as_its_header(report, name):
    tables = [table for each in report(name).sections for table in blocks(each, Table)]
    assert tables
    for table in tables:
        assert table.title
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.header)}
        assert all(isinstance(cell, str) for row in table.rows for cell in row)
        assert not any("None" in cell or "nan" in cell.lower().split() for row in table.rows for cell in row)


def test_a_report_of_everything_has_every_section(report):
    document = report("whole")
    ends = ["Mixed cycles", "Logs", "How to reproduce"]
    assert titles(document.sections) == ["Lifting", "Lowering", *ends]
    inside = ["Measured and simulated", "Parameters", "Accuracy", "Errors", "Trust", "Search and training"]
    for mode in MODES:
        assert titles(section(document, mode.capitalize()).sections) == inside
        pictures = blocks(section(document, mode.capitalize()), Pictures)
        names = {each.name for group in pictures for each in group.items}
        assert names == {
            f"{mode}-{name}"
            for name in (
                "horizons",
                "tests",
                "outputs",
                "distribution",
                "predicted-errors",
                "coverage",
                "correlations",
                "places",
                "intervals",
                "valve",
                "convergence",
                "losses",
                "structures",
            )
        }


def test_a_report_has_sections_only_for_what_there_is(report):
    alone = report("lifting alone")
    assert titles(alone.sections) == ["Lifting", "Logs", "How to reproduce"]
    inside = ["Measured and simulated", "Parameters", "Accuracy", "Errors", "Trust"]
    assert titles(section(alone, "Lifting").sections) == inside
    names = {each.name for each in alone.pictures}
    assert not {name for name in names if name.startswith(("lowering", "cycles"))}
    assert not {name for name in names if name.endswith(("coverage", "intervals", "convergence", "losses"))}


def test_a_model_that_diverged_is_reported_without_the_errors_nobody_can_test(report):
    document = report("diverging")
    assert "Trust" not in titles(section(document, "Lifting").sections)
    assert "Trust" in titles(section(document, "Lowering").sections)
    (accuracy,) = (
        table for table in blocks(section(document, "Lifting"), Table) if "accuracy" in table.title
    )
    (row,) = (row for row in accuracy.rows if row[:2] == ("grey box", "free run"))
    assert set(row[2:]) == {"diverged"}


def test_logs_of_cycles_alone_are_reported_by_their_strokes(logs, tmp_path):
    (tmp_path / "logs").mkdir()
    shutil.copy(logs / "cycle-01.csv", tmp_path / "logs")
    campaign = read(tmp_path / "logs")
    document = validate(PLAIN, campaign).report()
    assert titles(document.sections)[:3] == ["Lifting", "Lowering", "Mixed cycles"]
    assert [each for each in document.pictures if each.name == "timeline"]


# --- the verdict --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARTS)
def test_the_verdict_has_the_figures_of_the_result(report, validated, name):
    document = report(name)
    for mode, channel in validated(name).metrics["channels"].items():
        (free,) = findings(document, f"{mode.capitalize()}", "free run")
        figures = channel["greybox"]["free_run"]
        assert f"{len(channel['tests'])} unseen tests" in free.sentence
        if figures["rmse"] is None:
            assert (free.level, "diverged" in free.sentence) == (Rating.BAD, True)
            continue
        told = float(re.search(r"RMSE ([\d.e+-]+)", free.sentence)[1])
        # Two digits of the standard error are told, so half a unit of the second.
        assert told == pytest.approx(figures["rmse"], abs=0.1 * figures["rmse_error"])
        assert f"(fit {figures['fit']:.3g} %)" in free.sentence


@pytest.mark.parametrize("name", PARTS)
def test_a_free_run_is_good_only_where_it_is_better_than_every_baseline(report, validated, name):
    document = report(name)
    for mode, channel in validated(name).metrics["channels"].items():
        (free,) = findings(document, mode.capitalize(), "free run")
        own = channel["greybox"]["free_run"]["rmse"]
        rivals = [each.get("free_run", {}).get("rmse") for each in channel["baselines"].values()]
        rivals = [rival for rival in rivals if rival is not None]
        better = own is not None and bool(rivals) and own < min(rivals)
        assert better or free.level != Rating.GOOD
        if own is not None and rivals:
            assert f"{min(rivals):.3g} mm" in free.sentence
        if own is not None and not rivals:
            assert "no baseline" in free.sentence


@pytest.fixture
def judged(validated):
    """Return a function that judges the whole model anew after figures or runs of lifting were changed."""

    def judge(change=lambda lifting: lifting, runs=lambda tests: tests.models):
        result = validated("whole")
        lifting = change(result.channels[LIFTING])
        tests = lifting.accuracy.predictions
        rows = runs(tests)
        baselines = {
            name: ModelFigures(free_run=RunFigures.of(tests.actual, rows[name]))
            for name in (*BASELINES, "benchmark")
            if name in rows
        }
        models = {name: found for name, found in lifting.accuracy.models.items() if name not in BASELINES}
        accuracy = replace(
            lifting.accuracy, predictions=replace(tests, models=rows), models={**models, **baselines}
        )
        channels = {**result.channels, LIFTING: replace(lifting, accuracy=accuracy)}
        return verdict_section(replace(result, channels=channels), None)

    return judge


def with_free_run(lifting, **figures):
    """Return the results with other figures of the grey box in free run."""
    models = lifting.accuracy.models
    greybox = replace(models["greybox"], free_run=replace(models["greybox"].free_run, **figures))
    return replace(lifting, accuracy=replace(lifting.accuracy, models={**models, "greybox": greybox}))


def with_bands(lifting, **figures):
    """Return the results with other figures of the bands."""
    bands = replace(lifting.accuracy.bands, **figures)
    return replace(lifting, accuracy=replace(lifting.accuracy, bands=bands))


def with_parameters(lifting, names):
    """Return the results with the estimates of some parameters alone."""
    estimates = tuple(each for each in lifting.parameters.parameters if each.name in names)
    return replace(lifting, parameters=replace(lifting.parameters, parameters=estimates))


def finding(verdict, *words):
    """Return the one finding that says some words."""
    (found,) = (each for each in verdict if all(word in each.sentence for word in words))
    return found


BASELINES = ("transfer_function", "paper", "arx", "oe", "narx", "lstm")


@pytest.mark.parametrize(
    ("factors", "level"),
    # By how much the free run errs less than every baseline in each of three tests.
    [((0.5, 0.5, 0.5), Rating.GOOD), ((0.9, 0.5, 0.99), Rating.CAUTION), ((1.5, 1.5, 1.5), Rating.CAUTION)],
)
def test_a_free_run_is_good_where_tests_tell_it_apart_from_every_baseline(judged, factors, level):
    def erring(tests):
        own = tuple(y + factor for y, factor in zip(tests.actual, factors, strict=True))
        rivals = tuple(y + 1.0 for y in tests.actual)
        return {**tests.models, "free_run": own, "benchmark": own, **dict.fromkeys(BASELINES, rivals)}

    rmse = float(np.sqrt(np.mean(np.square(factors))))
    verdict = judged(partial(with_free_run, rmse=rmse, fit=95.0), erring)
    assert finding(verdict, "Lifting, free run").level == level


def test_a_free_run_worse_than_a_mean_is_bad(judged):
    verdict = judged(partial(with_free_run, fit=-1.0))
    assert finding(verdict, "Lifting, free run").level == Rating.BAD


def test_baselines_that_all_diverged_are_told_from_none(judged):
    def wild(tests):
        return {**tests.models, **dict.fromkeys(BASELINES, tuple(np.inf * y for y in tests.actual))}

    def none(tests):
        return {name: rows for name, rows in tests.models.items() if name not in BASELINES}

    for runs, said in ((wild, "every baseline diverged"), (none, "no baseline was fitted")):
        found = finding(judged(runs=runs), "Lifting, free run")
        assert (found.level, said in found.sentence) in ((Rating.CAUTION, True), (Rating.BAD, False))


@pytest.mark.parametrize(
    ("covered", "level"),
    [(0.5, Rating.BAD), (0.84, Rating.BAD), (0.86, Rating.GOOD), (0.94, Rating.GOOD), (0.99, Rating.CAUTION)],
)
def test_a_band_is_judged_by_what_it_holds(judged, covered, level):
    told = {"covered": covered, "covered_error": 0.01, "horizons": None}
    band = finding(judged(partial(with_bands, **told)), "Lifting", "band")
    assert band.level == level
    assert f"{100 * covered:.0f} % of samples fell inside" in band.sentence


def test_a_band_is_not_judged_by_tests_that_tell_little(judged):
    told = {"covered": 0.8, "covered_error": 0.06, "horizons": None}
    band = finding(judged(partial(with_bands, **told)), "Lifting", "band")
    assert (band.level, "not significant" in band.sentence) == (Rating.CAUTION, True)
    alone = {"covered": 0.8, "covered_error": None, "horizons": None}
    band = finding(judged(partial(with_bands, **alone)), "Lifting", "band")
    assert (band.level, "too few" in band.sentence) == (Rating.CAUTION, True)


def test_parameters_that_are_not_determined_are_named(report):
    said = finding(report("whole").verdict, "Lifting", "parameters")
    assert said.level == Rating.CAUTION
    assert "3 of 5" in said.sentence
    assert said.sentence.endswith(": τ, ωh, ξh.")


@pytest.mark.parametrize("names", [("gain",), ("gain", "curvature")])
def test_parameters_that_all_are_determined_are_good(judged, names):
    assert (
        finding(judged(partial(with_parameters, names=names)), "Lifting", "parameter", "determined").level
        == Rating.GOOD
    )


def test_nothing_is_said_of_parameters_that_nobody_told(judged):
    verdict = judged(partial(with_parameters, names=()))
    assert not [each for each in verdict if "Lifting" in each.sentence and "parameter" in each.sentence]


def test_one_cycle_is_too_few_to_judge(report, validated):
    own = validated("whole").cycles.accuracy.free_run()
    said = finding(report("whole").verdict, "Mixed cycles, free run")
    assert said.level in (Rating.CAUTION, Rating.BAD)
    assert "1 unseen cycle " in said.sentence
    assert f"{own.rmse:.4g} mm" in said.sentence


LIMITS = 'unit = "mm"\n[lifting]\ntests = {tests}\nfree_run.rmse = {rmse}\n'


@pytest.mark.parametrize(("tests", "rmse", "failed"), [(3, 90.0, 0), (3, 1e-3, 1), (99, 1e-3, 2)])
def test_acceptance_tells_what_fails_and_stands_first_where_something_does(
    validated, tmp_path, tests, rmse, failed
):
    (tmp_path / "limits.toml").write_text(LIMITS.format(tests=tests, rmse=rmse))
    result = validated("lifting alone")
    acceptance = result.check(read_limits(tmp_path / "limits.toml"))
    found = verdict_section(result, acceptance)
    first = found[0] if failed else finding(found, "Accepted")
    assert first.level == (Rating.BAD if failed else Rating.GOOD)
    assert first.sentence.startswith("Not accepted" if failed else "Accepted")
    below = limits_section(acceptance)
    assert below.title == "Acceptance"
    (table,) = blocks(below, Table)
    assert [row[-1] for row in table.rows].count("fail") == failed
    said = [item for group in blocks(below, Findings) for item in group.items]
    assert len(said) == failed
    assert {each.level for each in said} <= {Rating.BAD}
    for check in acceptance.checks:
        assert (check.name in first.sentence) == (not check.passed)


def test_without_limits_nothing_is_accepted(report):
    assert not findings(report("whole"), "ccepted")


# --- logs and origin ----------------------------------------------------------------------------------------


def test_the_table_of_logs_has_every_log_with_its_hash(report, logs, campaign):
    (table,) = blocks(section(report("whole"), "Logs"), Table)
    assert [row[0] for row in table.rows] == [record.name for record in campaign.records]
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    for record in campaign.records:
        row = rows[record.name]
        whole = hashlib.sha256((logs / f"{record.name}.csv").read_bytes()).hexdigest()
        assert len(row["SHA-256, first 16"]) == 16
        assert whole.startswith(row["SHA-256, first 16"])
        assert row["samples"] == str(len(record))
        assert float(row["duration / s"]) == pytest.approx(0.01 * (len(record) - 1))


def test_the_table_of_logs_says_what_each_was_used_for(logs, tmp_path):
    place = shutil.copytree(logs, tmp_path / "logs")
    still = {name: np.zeros(60) for name in ("current_up_A", "current_down_A")}
    columns = {"time_s": 0.01 * np.arange(60), **still, "displacement_mm": np.full(60, 7.0)}
    write_table(place / "resting.csv", columns)
    (place / "campaign.toml").write_text('[tests]\n"lowering-03" = "ramp"')
    campaign = read(place)
    records = {record.name: record for record in campaign.records}
    used = Provenance(
        identification={LIFTING: ("lifting-01", "lifting-02")},
        validation={LIFTING: ("lifting-02",)},
        seen=frozenset(records[name].fingerprint for name in ("lifting-01", "lifting-02")),
    )
    found = logs_section(log_data(handmade.hitch("integrator", provenance=used), campaign))
    (table,) = blocks(found, Table)
    assert {row[0]: row[2] for row in table.rows} == {
        "lifting-01": "identification",
        "lifting-02": "early stopping",
        "lifting-03": "unseen test",
        "lowering-01": "unseen test",
        "lowering-02": "unseen test",
        "lowering-03": "ramp for the dead zone",
        "cycle-01": "unseen cycle",
        "resting": "not used",
    }


def test_what_the_audit_found_stands_with_the_logs(logs, tmp_path):
    place = shutil.copytree(logs, tmp_path / "logs")
    (path,) = place.glob("lifting-02.csv")
    header, *rows = path.read_text().splitlines()
    for row, reading in ((90, "9.0"), (120, "999.0")):  # a spike within the travel, an error code outside
        rows[row] = f"{rows[row].rpartition(',')[0]},{reading}"
    path.write_text("\n".join([header, *rows, ""]))
    found = logs_section(log_data(handmade.hitch("integrator"), read(place)))
    said = [item for group in blocks(found, Findings) for item in group.items]
    for finding in ("lifting-02: spikes", "lifting-02: not measured: 1 of 250 samples"):
        assert any(item.level is Rating.CAUTION and finding in item.sentence for item in said)


def test_how_to_reproduce_names_command_seed_settings_and_versions():
    now = installed_versions()
    provenance = Provenance(
        seed=7, settings={"search": {"evaluations": 60}}, versions={**now, "jax": "0.0.1"}, digest="f00d"
    )
    table, settings = blocks(origin_section(Origin(provenance, PLAIN.step_s, now), COMMAND), Table)
    told = dict(table.rows)
    assert told["command"] == COMMAND
    assert told["model's digest"] == "f00d"
    assert told["seed of the identification"] == "7"
    assert settings.rows == (("search.evaluations", "60"),)
    assert told["version of numpy"] == np.__version__
    assert told["version of jax"] == f"0.0.1 at identification, {now['jax']} now"


def test_settings_are_shown_by_the_keys_and_in_the_values_of_the_settings_file():
    described = {
        "structure": {
            LIFTING: {"automatic": True, "load": None},
            LOWERING: {"structure": "integrator", "spool": False, "bounds": {"gain": [1.0, 50.0]}},
        },
        "search": {"method": "whale", "evaluations": 600, "stagnation": None},
        # As models of the first versions have it.
        "training": "CompensatorConfig(hidden=8, adam=AdamConfig(epochs=15), free_run=None, baselines=True)",
        "dead_zones": {LIFTING: 0.35},
        "drift": False,
    }
    origin = Origin(Provenance(settings=described, name="my-hitch", date="2025-03-31"), PLAIN.step_s, {})
    table, settings = blocks(origin_section(origin, COMMAND), Table)
    assert dict(settings.rows) == {
        "lifting.structure": '"automatic"',
        "lifting.dead_zone": "0.35",
        "lowering.structure": '"integrator"',
        "lowering.spool": "false",
        "lowering.bounds.gain": "[1.0, 50.0]",
        "search.method": '"whale"',
        "search.evaluations": "600",
        "training.hidden": "8",
        "training.adam.epochs": "15",
        "training.baselines": "true",
        "drift": "false",
    }
    for key, value in settings.rows:
        tomllib.loads(f"{key} = {value}")
    assert ("model", "my-hitch") in table.rows
    assert ("date of the model's files", "2025-03-31") in table.rows


@pytest.mark.parametrize("told", ["Whale(", "not a call", "f(x)", "Whale(config=WhaleConfig(population=y))"])
def test_a_setting_that_is_no_call_of_constants_is_shown_as_text(told):
    origin = Origin(Provenance(settings={"search": told}), PLAIN.step_s, {})
    _, settings = blocks(origin_section(origin, COMMAND), Table)
    assert settings.rows == (("search", f'"{told}"'),)


# --- comparison ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compared(bench_folder):
    """Return a function that compares two models, once for each pair, and reports on it."""
    campaign = read(bench_folder)
    pairs = {
        "right and plain": (known(RIGHT, LIFTING), known(PLAIN, *MODES)),
        "diverging and plain": (diverging(PLAIN), PLAIN),
        "alike": (PLAIN, PARTS["lifting alone"]),
    }
    found = {}

    def run(name):
        if name not in found:
            with np.errstate(all="ignore"):
                result = compare(pairs[name], campaign, ["old", "new"])
            found[name] = result, result.report(command=COMMAND)
        return found[name]

    return run


@pytest.mark.parametrize(
    ("pair", "better"), [("right and plain", "A"), ("diverging and plain", "B"), ("alike", None)]
)
def test_the_verdict_names_the_model_that_errs_less(compared, pair, better):
    result, document = compared(pair)
    tests = result.free_runs(LIFTING)
    rmse = {name: np.sqrt(np.mean(tests.rmse(name) ** 2)) for name in "AB"}
    (lifting,) = findings(document, "Lifting")
    if better is None:
        assert lifting.level == Rating.CAUTION
        assert "A and B have the same error" in lifting.sentence
    else:
        assert lifting.level == Rating.GOOD
        assert lifting.sentence.startswith(f"Lifting: {better} has a significantly smaller error")
        worse = {"A": "B", "B": "A"}[better]
        assert not rmse[better] > rmse[worse]


@pytest.mark.parametrize("pair", ["right and plain", "diverging and plain", "alike"])
def test_a_comparison_shows_every_part_that_both_have(compared, pair):
    result, document = compared(pair)
    parts = [part.capitalize() for part in result.sections]
    assert parts[:1] == ["Lifting"]
    assert titles(document.sections)[: len(parts)] == parts
    assert titles(document.sections)[-1] == "How to reproduce"
    names = [each.name for each in document.pictures]
    assert len(names) == len(set(names))
    for part in result.sections:
        assert {f"{part}-overlay", f"{part}-horizons", f"{part}-tests"} <= set(names)
    assert ("Parameters" in titles(document.sections)) == (pair == "right and plain")
    assert "old" in document.subtitle
    assert "new" in document.subtitle


def test_parameters_of_two_models_stand_side_by_side(compared):
    _, document = compared("right and plain")
    lifting, lowering = blocks(section(document, "Parameters"), Table)
    gain = lifting.rows[0]
    assert gain == ("gain", "K = 30.0 ± 1.0 mm/(s·A)", "K = 30.0 ± 1.0 mm/(s·A)")
    assert {row[1] for row in lowering.rows} == {"not in the model"}


# --- on disk ------------------------------------------------------------------------------------------------


@pytest.fixture
def write():
    """Return a function that writes a small report into a folder."""
    files = {"metrics.json": b"{}", "tables.md": b"# Validation"}
    return partial(write_report, document=reported.document(), files=files, mark="metrics.json")


def test_a_report_is_written_with_its_figures_and_what_goes_with_it(write, tmp_path):
    write(tmp_path / "out")
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    names = (
        ".hitchid.json",
        "report.html",
        "metrics.json",
        "tables.md",
        f"{FIGURES}/curve.svg",
        f"{FIGURES}/long.svg",
    )
    assert written == {f"out/{name}" for name in names}
    assert (tmp_path / "out" / "metrics.json").read_bytes() == b"{}"


def test_the_same_result_is_written_as_the_same_bytes(validated, campaign, tmp_path):
    for name in ("one", "two"):
        document = validated("lifting alone").report(command=COMMAND)
        write_report(tmp_path / name, document, {"metrics.json": b"{}"}, mark="metrics.json")
    written = [path for path in (tmp_path / "one").rglob("*.*") if path.is_file()]
    assert len(written) > 8
    for path in written:
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()


def test_what_is_there_is_replaced_by_force_and_only_where_it_is_a_report(write, tmp_path):
    place = tmp_path / "out"
    write(place)
    (place / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="--force"):
        write(place)
    with pytest.raises(OutputError, match=r"mine\.txt"):
        write(place, force=True)
    (place / "mine.txt").unlink()
    write(place, force=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"no \.hitchid\.json"):
        write(tmp_path / "other", force=True)
    assert (tmp_path / "other" / "mine.txt").read_text() == "mine"


def test_a_report_that_cannot_be_made_leaves_nothing_and_the_older_one(write, tmp_path, monkeypatch):
    write(tmp_path / "out")
    before = (tmp_path / "out" / "report.html").read_bytes()
    monkeypatch.setattr("hitchid.report.write.find_spec", lambda name: None)
    for place in (tmp_path / "new", tmp_path / "out"):
        with pytest.raises(InputError, match=r"hitchid\[pdf\]"):
            write(place, formats=["pdf"], force=True)
    assert (tmp_path / "out" / "report.html").read_bytes() == before
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_a_pdf_stands_beside_the_page(write, tmp_path):
    pytest.importorskip("typst", reason="typst is not installed; pip install 'hitchid[pdf]'")
    write(tmp_path / "out", formats=["pdf"])
    assert (tmp_path / "out" / "report.pdf").read_bytes().startswith(b"%PDF")


def test_logs_of_any_name_are_reported(logs, tmp_path):
    place = shutil.copytree(logs, tmp_path / "logs")
    half, markup = "\udcff", "$\\frac$ <script>& #1b1b1f"
    (place / "lifting-01.csv").rename(place / f"lifting-{half}.csv")
    shutil.copy(place / "cycle-01.csv", place / f"cycle-{half}.csv")
    (place / "cycle-01.csv").rename(place / f"cycle-{markup}.csv")
    campaign, model = read(place), PARTS["lifting alone"]
    document = validate(model, campaign).report()
    write_report(tmp_path / "out", document, {"metrics.json": b"{}"}, mark="metrics.json")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script" not in page
    timeline = page[page.index('id="figure-timeline"') :]
    assert escape(f">cycle-{markup}<", quote=False)[4:-4] in timeline[: timeline.index("</svg>")]


@pytest.mark.long
def test_a_report_of_forty_tests_is_smaller_than_3_megabytes(tmp_path):
    campaign = read(benches.write_bench(tmp_path / "logs", tests=20, samples=1000))
    assert len(campaign.records) == 40
    document = validate(PLAIN, campaign).report()
    write_report(tmp_path / "out", document, {"metrics.json": b"{}"}, mark="metrics.json")
    assert (tmp_path / "out" / "report.html").stat().st_size < 3e6
    assert all(len(each.caption) < 400 for each in document.pictures)


def test_limits_stand_before_the_directions(validated, campaign, tmp_path):
    (tmp_path / "limits.toml").write_text(LIMITS.format(tests=3, rmse=1.0))
    result = validated("lifting alone")
    acceptance = result.check(read_limits(tmp_path / "limits.toml"))
    document = result.report(acceptance=acceptance)
    assert titles(document.sections)[:2] == ["Acceptance", "Lifting"]
    assert finding(document.verdict, "ccepted").level in Rating


def test_notices_of_the_result_are_sentences_of_the_report(report, validated):
    notices = validated("whole").notices
    assert notices
    for notice, said in zip(notices, report("whole").notices, strict=True):
        assert said.lower() == f"{notice.lower()}."


def test_lowering_logs_are_not_used_by_a_model_that_only_lifts(report):
    (table,) = blocks(section(report("lifting alone"), "Logs"), Table)
    uses = {row[0]: row[2] for row in table.rows}
    assert uses["lifting-01"] == "unseen test"
    assert uses["lowering-01"] == "not used"

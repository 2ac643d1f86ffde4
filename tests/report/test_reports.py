"""Reports of made-up benches: a verdict true to the figures, and a section for what there is."""

import hashlib
import re
import shutil
import tomllib
from dataclasses import replace
from functools import cache, partial
from html import escape

import equinox as eqx
import numpy as np
import pytest

import benches
import handmade
import reported
from hitchid._support.jax_setup import installed_versions
from hitchid.errors import InputError
from hitchid.logs import read, write_table
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Provenance, Uncertainty
from hitchid.report import FIGURES, Pictures, Rating, Table, check_renderers, render, write_report
from hitchid.report.document import Findings
from hitchid.report.origin import logs_section, origin_section
from hitchid.report.verdict import verdict_section
from hitchid.validation import ModelFigures, RunFigures, compare, read_limits, validate
from hitchid.validation.report_data import Origin, log_data

MODES = (LIFTING, LOWERING)
COMMAND = "hitchid validate 'my model' logs --out report"


def known(model, *modes):
    """Return a model that tells its parameters, as one that was identified does."""
    benchmark = reported.known_estimates()
    uncertainty = {
        mode: replace(model.uncertainty.get(mode, Uncertainty(benchmark)), benchmark=benchmark)
        for mode in modes
    }
    return replace(model, uncertainty={**model.uncertainty, **uncertainty})


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

    @cache
    def run(name):
        with np.errstate(all="ignore"):
            return validate(PARTS[name], campaign)

    return run


@pytest.fixture(scope="module")
def report(validated):
    """Return a function that reports on one of `PARTS`; the trace is that of an identification with all."""
    trace = dict.fromkeys(MODES, reported.trace())

    @cache
    def make(name):
        return validated(name).report(command=COMMAND, **({"trace": trace} if name == "whole" else {}))

    return make


def blocks(section, kind):
    """Return every block of a kind in a section and those below it."""
    inside = [block for block in section.blocks if isinstance(block, kind)]
    return inside + [block for below in section.sections for block in blocks(below, kind)]


def titles(sections):
    return [section.title for section in sections]


def section(document, title):
    (matching,) = (section for section in document.sections if section.title == title)
    return matching


def findings(verdict, *words):
    """Return the findings of a verdict that say some words."""
    return [finding for finding in verdict if all(word in finding.sentence for word in words)]


def finding(verdict, *words):
    """Return the one finding that says some words."""
    (matching,) = findings(verdict, *words)
    return matching


# --- what a report holds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PARTS)
def test_every_figure_has_its_words_and_every_table_its_cells(report, name, recwarn):
    pictures = list(report(name).pictures)
    names = [picture.name for picture in pictures]
    assert len(names) == len(set(names)) > 5
    for picture in pictures:
        assert re.fullmatch(r"[a-z]+(-[a-z]+)*", picture.name)
        assert min(len(picture.caption), len(picture.alt)) > 20
        assert picture.wide == (picture.figure.get_figwidth() > 4)
        assert "<svg" in picture.svg
    tables = [table for part in report(name).sections for table in blocks(part, Table)]
    assert tables
    for table in tables:
        assert table.title
        assert {len(row) for row in table.rows} == {len(table.header)}
        assert all(isinstance(cell, str) for row in table.rows for cell in row)
        assert not any("None" in cell or "nan" in cell.lower().split() for row in table.rows for cell in row)
    assert not [str(warning.message) for warning in recwarn]


def test_a_report_of_everything_has_every_section(report, validated):
    document = report("whole")
    ends = ["Mixed cycles", "Logs", "How to reproduce"]
    assert titles(document.sections) == ["Lifting", "Lowering", *ends]
    inside = ["Measured and simulated", "Parameters", "Accuracy", "Errors", "Trust", "Search and training"]
    drawn = (
        *("horizons", "tests", "outputs", "distribution", "predicted-errors", "coverage", "correlations"),
        *("places", "intervals", "valve", "convergence", "losses", "structures"),
    )
    for mode in MODES:
        own = section(document, mode.capitalize())
        assert titles(own.sections) == inside
        names = {picture.name for group in blocks(own, Pictures) for picture in group.items}
        assert names == {f"{mode}-{name}" for name in drawn}
    notices = validated("whole").notices
    assert notices
    assert [notice.lower() for notice in document.notices] == [f"{notice.lower()}." for notice in notices]
    # Without limits nothing is accepted, and one cycle is too few to judge.
    assert not findings(document.verdict, "ccepted")
    cycles = finding(document.verdict, "Mixed cycles, free run", "1 unseen cycle ")
    assert cycles.level in (Rating.CAUTION, Rating.BAD)
    assert f"{validated('whole').cycles.accuracy.free_run().rmse:.4g} mm" in cycles.sentence


def test_a_report_has_sections_only_for_what_there_is(report):
    alone = report("lifting alone")
    assert titles(alone.sections) == ["Lifting", "Logs", "How to reproduce"]
    inside = ["Measured and simulated", "Parameters", "Accuracy", "Errors", "Trust"]
    assert titles(section(alone, "Lifting").sections) == inside
    names = {picture.name for picture in alone.pictures}
    assert not {name for name in names if name.startswith(("lowering", "cycles"))}
    assert not {name for name in names if name.endswith(("coverage", "intervals", "convergence", "losses"))}
    (table,) = blocks(section(alone, "Logs"), Table)
    uses = {row[0]: row[2] for row in table.rows}
    assert (uses["lifting-01"], uses["lowering-01"]) == ("unseen test", "not used")


def test_a_diverged_model_is_reported_without_tests_of_errors(report):
    document = report("diverging")
    assert "Trust" not in titles(section(document, "Lifting").sections)
    assert "Trust" in titles(section(document, "Lowering").sections)
    (accuracy,) = (
        table for table in blocks(section(document, "Lifting"), Table) if "accuracy" in table.title
    )
    (row,) = (row for row in accuracy.rows if row[:2] == ("grey box", "free run"))
    assert set(row[2:]) == {"diverged"}


def test_logs_of_cycles_alone_are_reported_by_their_strokes(logs, tmp_path):
    shutil.copy(logs / "cycle-01.csv", tmp_path)
    document = validate(PLAIN, read(tmp_path)).report()
    assert titles(document.sections)[:3] == ["Lifting", "Lowering", "Mixed cycles"]
    assert [picture for picture in document.pictures if picture.name == "timeline"]


# --- the verdict --------------------------------------------------------------------------------------------


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
        models = {name: figures for name, figures in lifting.accuracy.models.items() if name not in BASELINES}
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


BASELINES = ("transfer_function", "paper", "arx", "oe", "narx", "lstm")


@pytest.mark.parametrize(
    ("factors", "level"),
    # By how much the free run errs less than every baseline in each of three tests.
    [((0.5, 0.5, 0.5), Rating.GOOD), ((0.9, 0.5, 0.99), Rating.CAUTION), ((1.5, 1.5, 1.5), Rating.CAUTION)],
)
def test_a_free_run_is_good_if_significantly_better_than_baselines(judged, factors, level):
    def erring(tests):
        own = tuple(y + factor for y, factor in zip(tests.actual, factors, strict=True))
        rivals = tuple(y + 1.0 for y in tests.actual)
        return {**tests.models, "free_run": own, "benchmark": own, **dict.fromkeys(BASELINES, rivals)}

    rmse = float(np.sqrt(np.mean(np.square(factors))))
    verdict = judged(partial(with_free_run, rmse=rmse, fit=95.0), erring)
    assert finding(verdict, "Lifting, free run").level == level


def test_baselines_that_all_diverged_are_told_from_none(judged):
    def wild(tests):
        return {**tests.models, **dict.fromkeys(BASELINES, tuple(np.inf * y for y in tests.actual))}

    def none(tests):
        return {name: rows for name, rows in tests.models.items() if name not in BASELINES}

    for runs, words in ((wild, "every baseline diverged"), (none, "no baseline was fitted")):
        judgement = finding(judged(runs=runs), "Lifting, free run")
        assert (judgement.level, words in judgement.sentence) in (
            (Rating.CAUTION, True),
            (Rating.BAD, False),
        )


@pytest.mark.parametrize(
    ("covered", "error", "level", "words"),
    [
        *((covered, 0.01, Rating.BAD, "") for covered in (0.5, 0.84)),
        *((covered, 0.01, Rating.GOOD, "") for covered in (0.86, 0.94)),
        (0.99, 0.01, Rating.CAUTION, ""),
        (0.8, 0.06, Rating.CAUTION, "not significant"),
        (0.8, None, Rating.CAUTION, "too few"),
    ],
)
def test_a_band_is_judged_by_what_it_holds(judged, covered, error, level, words):
    bands = {"covered": covered, "covered_error": error, "horizons": None}
    band = finding(judged(partial(with_bands, **bands)), "Lifting", "band")
    assert band.level == level
    assert f"{100 * covered:.0f} % of samples fell inside" in band.sentence
    assert words in band.sentence


def test_parameters_that_are_not_determined_are_named(report):
    said = finding(report("whole").verdict, "Lifting", "parameters")
    assert said.level == Rating.CAUTION
    assert "3 of 5" in said.sentence
    assert said.sentence.endswith(": τ, ωh, ξh.")


LIMITS = 'unit = "mm"\n[lifting]\ntests = {tests}\nfree_run.rmse = {rmse}\n'


@pytest.mark.parametrize(("tests", "rmse", "failed"), [(3, 90.0, 0), (3, 1e-3, 1), (99, 1e-3, 2)])
def test_acceptance_stands_first_and_tells_what_fails(validated, tmp_path, tests, rmse, failed):
    (tmp_path / "limits.toml").write_text(LIMITS.format(tests=tests, rmse=rmse))
    result = validated("lifting alone")
    acceptance = result.check(read_limits(tmp_path / "limits.toml"))
    document = result.report(acceptance=acceptance)
    assert titles(document.sections)[:2] == ["Acceptance", "Lifting"]
    judgement = document.verdict[0] if failed else finding(document.verdict, "Accepted")
    assert judgement.level == (Rating.BAD if failed else Rating.GOOD)
    assert judgement.sentence.startswith("Not accepted" if failed else "Accepted")
    for check in acceptance.checks:
        assert (check.name in judgement.sentence) == (not check.passed)
    (table,) = blocks(document.sections[0], Table)
    assert [row[-1] for row in table.rows].count("fail") == failed
    failures = [item for group in blocks(document.sections[0], Findings) for item in group.items]
    assert [item.level for item in failures] == [Rating.BAD] * failed


# --- logs and origin ----------------------------------------------------------------------------------------


def test_the_table_of_logs_has_every_log_with_its_hash(report, logs, campaign):
    (table,) = blocks(section(report("whole"), "Logs"), Table)
    assert [row[0] for row in table.rows] == [record.name for record in campaign.records]
    for record, cells in zip(campaign.records, table.rows, strict=True):
        row = dict(zip(table.header, cells, strict=True))
        whole = hashlib.sha256((logs / f"{record.name}.csv").read_bytes()).hexdigest()
        assert row["SHA-256, first 16"] == whole[:16]
        assert row["samples"] == str(len(record))
        assert float(row["duration / s"]) == pytest.approx(0.01 * (len(record) - 1))


def test_the_table_of_logs_says_what_each_was_used_for(logs, tmp_path):
    copy = shutil.copytree(logs, tmp_path / "logs")
    still = {name: np.zeros(60) for name in ("current_up_A", "current_down_A")}
    columns = {"time_s": 0.01 * np.arange(60), **still, "displacement_mm": np.full(60, 7.0)}
    write_table(copy / "resting.csv", columns)
    (copy / "campaign.toml").write_text('[tests]\n"lowering-03" = "ramp"')
    campaign = read(copy)
    records = {record.name: record for record in campaign.records}
    used = Provenance(
        identification={LIFTING: ("lifting-01", "lifting-02")},
        validation={LIFTING: ("lifting-02",)},
        seen=frozenset(records[name].fingerprint for name in ("lifting-01", "lifting-02")),
    )
    section = logs_section(log_data(handmade.hitch("integrator", provenance=used), campaign))
    (table,) = blocks(section, Table)
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
    copy = shutil.copytree(logs, tmp_path / "logs")
    (path,) = copy.glob("lifting-02.csv")
    header, *rows = path.read_text().splitlines()
    for row, reading in ((90, "9.0"), (120, "999.0")):  # a spike within the travel, an error code outside
        rows[row] = f"{rows[row].rpartition(',')[0]},{reading}"
    path.write_text("\n".join([header, *rows, ""]))
    section = logs_section(log_data(PLAIN, read(copy)))
    sentences = [item for group in blocks(section, Findings) for item in group.items]
    for words in ("lifting-02: spikes", "lifting-02: not measured: 1 of 250 samples"):
        assert any(item.level is Rating.CAUTION and words in item.sentence for item in sentences)


def test_how_to_reproduce_names_command_seed_settings_and_versions():
    now = installed_versions()
    provenance = Provenance(
        seed=7, settings={"search": {"evaluations": 60}}, versions={**now, "jax": "0.0.1"}, digest="f00d"
    )
    table, settings = blocks(origin_section(Origin(provenance, PLAIN.step_s, now), COMMAND), Table)
    rows = dict(table.rows)
    assert rows["command"] == COMMAND
    assert rows["model's digest"] == "f00d"
    assert rows["seed of the identification"] == "7"
    assert settings.rows == (("search.evaluations", "60"),)
    assert rows["version of numpy"] == np.__version__
    assert rows["version of jax"] == f"0.0.1 at identification, {now['jax']} now"


def test_settings_are_shown_as_in_the_settings_file():
    described = {
        "structure": {
            LIFTING: {"automatic": True, "load": None},
            LOWERING: {"structure": "integrator", "spool": False, "bounds": {"gain": [1.0, 50.0]}},
        },
        "search": {"method": "whale", "evaluations": 600, "stagnation": None},
        "training": {"hidden": 8, "adam": {"epochs": 15}, "free_run": None, "baselines": True},
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

    @cache
    def run(name):
        with np.errstate(all="ignore"):
            result = compare(pairs[name], campaign, ["old", "new"])
        return result, result.report(command=COMMAND)

    return run


@pytest.mark.parametrize(
    ("pair", "better"), [("right and plain", "A"), ("diverging and plain", "B"), ("alike", None)]
)
def test_the_verdict_names_the_model_that_errs_less(compared, pair, better):
    result, document = compared(pair)
    tests = result.free_runs(LIFTING)
    rmse = {name: np.sqrt(np.mean(tests.rmse(name) ** 2)) for name in "AB"}
    lifting = finding(document.verdict, "Lifting")
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
    names = [picture.name for picture in document.pictures]
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


def write(folder, **options):
    """Write a small report into a folder."""
    files = {"metrics.json": b"{}", "tables.md": b"# Validation"}
    write_report(folder, reported.document(), files, mark="metrics.json", **options)


def test_a_report_is_written_with_figures_and_further_files(tmp_path):
    pytest.importorskip("typst", reason="typst is not installed; pip install 'hitchid[pdf]'")
    write(tmp_path / "out", formats=["pdf"])
    written = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*.*")}
    names = (".hitchid.json", "report.html", "report.pdf", "metrics.json", "tables.md")
    assert written == {*names, f"{FIGURES}/curve.svg", f"{FIGURES}/long.svg"}
    assert (tmp_path / "out" / "metrics.json").read_bytes() == b"{}"
    assert (tmp_path / "out" / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("kind", ["pdf", "xlsx"])
def test_a_format_that_cannot_be_made_is_refused_first(tmp_path, monkeypatch, kind):
    write(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_bytes()
    monkeypatch.setattr("hitchid.report.write.find_spec", lambda name: None)
    check_renderers([])
    check_renderers(["html", "interactive"])
    for work in (
        lambda: check_renderers(["html", kind]),
        lambda: render(reported.document(), kind),
        lambda: write(tmp_path / "new", formats=[kind], force=True),
        lambda: write(tmp_path / "out", formats=[kind], force=True),
    ):
        with pytest.raises(InputError, match=rf"pip install 'hitchid\[{kind}\]'"):
            work()
    assert (tmp_path / "out" / "report.html").read_bytes() == page
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_logs_of_any_name_are_reported(logs, tmp_path):
    logs_copy = shutil.copytree(logs, tmp_path / "logs")
    half, markup = "\udcff", "$\\frac$ <script>& #1b1b1f"
    (logs_copy / "lifting-01.csv").rename(logs_copy / f"lifting-{half}.csv")
    shutil.copy(logs_copy / "cycle-01.csv", logs_copy / f"cycle-{half}.csv")
    (logs_copy / "cycle-01.csv").rename(logs_copy / f"cycle-{markup}.csv")
    campaign, model = read(logs_copy), PARTS["lifting alone"]
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
    assert all(len(picture.caption) < 400 for picture in document.pictures)

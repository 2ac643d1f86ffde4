"""The study in small: every table and figure of the paper, with the data behind each."""

import json
from html import unescape

import numpy as np
import pytest

from hitchid.bench import load_rig, simulate
from hitchid.bench.excitation import HIGH, LOW
from hitchid.bench.sun2025 import Plan
from hitchid.bench.sun2025.reproduce import reproduce
from hitchid.bench.sun2025.results import mechanistic
from hitchid.bench.virtual_campaign import DYNAMIC_S, STROKE_FRACTION
from hitchid.identification import AdamConfig, CompensatorConfig, MultiStart, SpeedCompensatorConfig
from hitchid.identification.identify import PAPER_SPECS
from hitchid.logs.record import DIRECTIONS, LIFTING


@pytest.mark.long
def test_a_small_study_writes_every_table_and_figure(tmp_path):
    plan = Plan(
        tests=5,
        cycles=1,
        structure=PAPER_SPECS,  # which form hitchid chooses plays no part here
        search=MultiStart(evaluations=60),
        rivals=False,
        # Which compensator ships and what stands beside it play no part: the layout is the same.
        training=CompensatorConfig(
            hidden=6,
            window=20,
            adam=AdamConfig(epochs=6, patience=6),
            free_run=SpeedCompensatorConfig(units=2),
        ),
    )
    study = reproduce(tmp_path / "study", plan=plan)
    assert [figure.number for figure in study.figures] == list(range(5, 13))
    page = unescape((tmp_path / "study" / "report.html").read_text())
    for number in range(5, 13):
        assert f"Figure {number} of the paper" in page
        assert (tmp_path / "study" / "figures" / f"figure-{number:02d}.svg").stat().st_size > 1000
        header, *rows = (tmp_path / "study" / "data" / f"figure-{number:02d}.csv").read_text().splitlines()
        assert "," in header
        assert rows
    text = (tmp_path / "study" / "study.md").read_text()
    titles = ("Table 2.", "Table 3.", "Table 4.", "mechanistic, free run", "Mechanistic model")
    for title in (*titles, "hitchid's default, free run", "paper's method on its own predictions"):
        assert title in text
        assert title in page
    metrics = json.loads((tmp_path / "study" / "metrics.json").read_text())
    # The study's own figures and the validation's are computed apart and must agree.
    for mode, result in study.results.items():
        errors = np.concatenate(
            [a - p for a, p in zip(result.test.actual, result.test.models["free_run"], strict=True)]
        )
        free_run = metrics["channels"][mode]["greybox"]["free_run"]["rmse"]
        np.testing.assert_allclose(np.sqrt(np.mean(errors**2)), free_run, rtol=1e-9)
        # The paper's method is published with a transfer function and no compensator for free run.
        paper = study.paper.model.channels[mode]
        assert paper.speed_compensator is None
        assert paper.benchmark.structure == PAPER_SPECS[mode].structure
    # The verdict begins with the default.
    assert page.index("Lifting, hitchid's default, free run: RMSE") < page.index("Lifting, free run: RMSE")


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_the_mechanistic_gain_gives_the_speed_of_a_test(mode):
    """At u₀ = v₀/K beyond the dead zone the bench passes the middle of the way at v₀.

    The speed is taken over ±5 mm, in which the load's pressure and the root of it, the speed, change by
    k/(2 W) · 5 mm < 1 %; hence the tolerance.
    """
    rig = load_rig("nominal")
    model = mechanistic(rig, mode)
    stroke_mm = 1e3 * float(rig.cylinder.stroke)
    speed = np.mean(LOW + HIGH) * STROKE_FRACTION * stroke_mm / DYNAMIC_S
    gain = model.physical_model.named_values()["gain"]
    currents = np.zeros((1, 1001, 2))
    currents[:, 20:, DIRECTIONS.index(mode)] = model.dead_zone + speed / gain
    start = 0.0 if mode == LIFTING else float(rig.cylinder.stroke)
    motion = simulate(rig, currents, initial_displacement_m=start)
    travel = 1e3 * np.abs(np.asarray(motion.displacement_m)[0] - start)
    near = np.flatnonzero(np.abs(travel - 0.5 * speed * DYNAMIC_S) < 5.0)
    assert np.polyfit(0.01 * near, travel[near], 1)[0] == pytest.approx(speed, rel=0.01)


def test_the_mechanistic_dead_zone_is_the_data_sheet_s():
    """It is the valve's overlap with half the hysteresis, on a bench whose valves differ from the nominal."""
    rig = load_rig("light-warm-worn")
    for mode, valve in zip(DIRECTIONS, (rig.lifting_valve, rig.lowering_valve), strict=True):
        overlap = float(valve.spool.dead_zone + valve.spool.hysteresis)
        assert mechanistic("light-warm-worn", mode).dead_zone == overlap

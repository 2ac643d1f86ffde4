"""The study in small: every table and figure of the paper, with the data behind each."""

import csv
import json

import numpy as np

from hitchid.identification import Descent, MultiStart, Training
from hitchid.study import Plan, reproduce


def test_a_small_study_writes_every_table_and_figure(tmp_path):
    plan = Plan(
        tests=5,
        cycles=1,
        search=MultiStart(evaluations=60),
        training=Training(hidden=6, window=20, descent=Descent(epochs=6, patience=6)),
    )
    study = reproduce(tmp_path / "study", plan=plan)
    assert [each.number for each in sorted(study.drawn, key=lambda each: each.number)] == list(range(5, 13))
    for number in range(5, 13):
        assert (tmp_path / "study" / "figures" / f"figure-{number:02d}.svg").stat().st_size > 1000
        with (tmp_path / "study" / "data" / f"figure-{number:02d}.csv").open() as file:
            header, *rows = csv.reader(file)
        assert len(header) >= 2
        assert len(rows) >= 1
    text = (tmp_path / "study" / "study.md").read_text()
    for title in ("Table 2.", "Table 3.", "Table 4."):
        assert title in text
    metrics = json.loads((tmp_path / "study" / "metrics.json").read_text())
    # The study's own figures and the validation's are computed apart and must agree.
    for mode, result in study.results.items():
        errors = np.concatenate(
            [a - p for a, p in zip(result.test.actual, result.test.benchmark, strict=True)]
        )
        free_run = metrics["channels"][mode]["benchmark"]["free_run"]["rmse"]
        np.testing.assert_allclose(np.sqrt(np.mean(errors**2)), free_run, rtol=1e-9)

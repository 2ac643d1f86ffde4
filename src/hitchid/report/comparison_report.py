"""The report of a comparison: which model errs less, side by side and overlaid."""

import numpy as np

from hitchid.report import figures, sections
from hitchid.report.document import (
    Document,
    Finding,
    Level,
    Picture,
    Pictures,
    Section,
    sentence,
)
from hitchid.validation import ModelComparison, Table


def comparison_report(compared: ModelComparison, *, names: tuple[str, str], command: str = "") -> Document:
    """Compose what a comparison found for people to read.

    Args:
        compared: the two models on tests that neither has seen.
        names: what the models are called, A and B.
        command: that wrote the report.
    """
    found = []
    for part in compared.parts:
        better, said = compared.verdict(part)
        found.append(Finding(Level.CAUTION if better is None else Level.GOOD, sentence(f"{part}: {said}")))
    parameters = compared.parameters()
    return Document(
        title="Comparison of two hitch models",
        subtitle=f"A: {names[0]}; B: {names[1]}",
        verdict=tuple(found),
        notices=tuple(map(sentence, compared.notices)),
        sections=(
            *(_part(compared, part) for part in compared.parts),
            *([Section("Parameters", tuple(parameters))] if parameters else []),
            Section("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),)),
        ),
    )


def _part(compared: ModelComparison, part: str) -> Section:
    unit, tests = compared.unit, compared.free_runs(part)
    some, picked = sections.shown_tests(tests, "b")
    both = compared.figures(part)
    steps = {"steps": both[0]["horizons"]["steps"]}
    ahead = {name: each["horizons"]["greybox"] for name, each in zip("ab", both, strict=True)}
    persistence = {"persistence": both[0]["horizons"]["persistence"]}
    rows = {name: tests.errors(name) for name in "ab"}
    finite = all(np.all(np.isfinite(errors)) for errors in rows.values())
    pictures = [
        Picture(
            f"{part}-overlay",
            figures.outputs(some, unit, ("a", "b")),
            f"Free runs of both models and their errors: {picked} ({', '.join(some.names)}).",
            f"Displacement and error over time of {', '.join(some.names)} for both models.",
        ),
        Picture(
            f"{part}-horizons",
            figures.horizons({**steps, **persistence, **ahead}, compared.step_s, unit),
            "Error over how far is looked ahead.",
            f"RMSE in {unit} over the horizon for both models.",
        ),
        Picture(
            f"{part}-tests",
            figures.errors_by_test(tests, unit, ("b", "a")),
            "Error of every test in free run; the bar is the figure over all tests.",
            f"RMSE of each of {len(tests.names)} tests for both models.",
        ),
    ]
    if finite:
        distribution = Picture(
            f"{part}-distribution",
            figures.error_distribution(rows, unit),
            "Errors in free run on all tests.",
            f"Distribution of errors in {unit} for both models.",
        )
        pictures.insert(1, distribution)
    tables = (compared.accuracy(part), compared.horizons(part))
    return Section(part.capitalize(), (*tables, Pictures(tuple(pictures))))

"""A log in, the same log out with the predicted displacement beside its columns."""

from pathlib import Path

import numpy as np

from hitchid.model import Hitch
from hitchid.readers import assemble, format_of, read_log, settings_of
from hitchid.readers.csv import write_rows
from hitchid.storage import write_file
from hitchid.units import conversion_factor


def simulate_log(
    model: Hitch,
    log: Path,
    out: Path,
    *,
    horizon: int | None = None,
    coverage: float | None = None,
    signals: Path | None = None,
    force: bool = False,
) -> tuple[str, ...]:
    """Write a log's columns and the displacement a model predicts for each of its rows.

    A log with gaps is predicted stretch by stretch; rows of no usable stretch get an empty cell.

    Args:
        model: an identified hitch.
        log: one log of any known format.
        out: CSV file to write.
        horizon: samples to look ahead, None for free run.
        coverage: share of samples that a band around the prediction shall hold; None for no band.
        signals: a file like `campaign.toml`.
        force: replace a file that is there.

    Returns:
        Where the free run leaves what the model's identification covered, in words.

    Raises:
        InputError: the log, its signal map or the place to write cannot be used.
    """
    settings = settings_of([log], signals)
    signal_map = settings[log.parent].signals
    campaign = assemble(read_log(log, signal_map), settings)
    header, rows = format_of(log).read_rows(log, signal_map.time.column)
    column = header.index(signal_map.time.column)
    factor = conversion_factor(signal_map.time.unit, "s", "time")
    time_s = factor * np.array([float(row[column]) for row in rows])
    kinds = ("predicted",) if coverage is None else ("predicted", "lower", "upper")
    columns, beyond = np.full((len(kinds), time_s.size), np.nan), []
    for record in campaign.records:
        values = [model.simulate(record) if horizon is None else model.predict(record, horizon=horizon)]
        if coverage is not None:
            values += model.band(record, coverage=coverage, horizon=horizon)
        beyond += [] if horizon is not None else model.extrapolation(record)
        edge = record.step_s / 2
        inside = (time_s > record.time_s[0] - edge) & (time_s < record.time_s[-1] + edge)
        columns[:, inside] = [np.interp(time_s[inside], record.time_s, each) for each in values]
    names = [added_name(signal_map.displacement.column, kind) for kind in kinds]
    cells = [["" if np.isnan(value) else f"{value:.9g}" for value in row] for row in columns.T.tolist()]
    write_file(
        out,
        lambda path: write_rows(
            path, [*header, *names], [[*row, *added] for row, added in zip(rows, cells, strict=True)]
        ),
        force=force,
    )
    return tuple(beyond)


def added_name(column: str, kind: str) -> str:
    """Return the name of an added column: `displacement_predicted_mm`, else `<name>_predicted`.

    Args:
        column: of the measured displacement.
        kind: `predicted`, or `lower` or `upper` for the ends of the band.
    """
    stem, separator, unit = column.partition("displacement_")
    return f"displacement_{kind}_{unit}" if separator and not stem else f"{column}_{kind}"

"""A long campaign like those of a machine in the field: 14 logs, 40 000 samples, some 200 strokes."""

import csv
import gzip
import io
from pathlib import Path

import numpy as np

NEUTRAL_PERCENT = 7.4745
LOGS, SAMPLES = 14, 40_000
MIN_REST_S = 1.0
SETTINGS = """[signals]
time = { column = "time_s", unit = "s" }
command = { column = "boom_percent", unit = "percent" }
displacement = { column = "boom_cm", unit = "cm" }

[split]
test = ["job-13", "job-14"]
"""


def write_long_job(source: Path, folder: Path) -> None:
    """Write the campaign: first halves of the field's logs before second halves of others, cut at rest.

    Args:
        source: folder of `field-excavator`.
        folder: gets the logs and their `campaign.toml`.
    """
    halves = [_halves(path) for path in sorted(source.glob("*.csv.gz"))]
    count = len(halves)
    pairs = [(n % count, (n + 1 + n // count) % count) for n in range(LOGS)]
    duration_s = sum(halves[a][0][0][-1] + halves[b][1][0][-1] for a, b in pairs)
    step_s = duration_s / SAMPLES
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text(SETTINGS, encoding="utf-8")
    for number, (first, second) in enumerate(pairs, start=1):
        first_half, second_half = _resample(halves[first][0], step_s), _resample(halves[second][1], step_s)
        second_half[:, 1] += first_half[-1, 1] - second_half[0, 1]
        table = np.concatenate([first_half, second_half])
        table = np.column_stack([step_s * np.arange(len(table)), table])
        np.savetxt(
            folder / f"job-{number:02d}.csv",
            table,
            delimiter=",",
            header="time_s,boom_percent,boom_cm",
            comments="",
            fmt="%.6f",
        )


Half = tuple[np.ndarray, np.ndarray, np.ndarray]


def _halves(path: Path) -> tuple[Half, Half]:
    """Return stamps from zero, command and displacement of both halves of a log, cut while it rests."""
    with gzip.open(path, "rt", encoding="utf-8") as text:
        rows = list(csv.DictReader(io.StringIO(text.read())))
    time_s, command, displacement = (
        np.array([float(row[column]) for row in rows]) for column in ("Time", "Boom Cmd", "Boom Ms")
    )
    increasing = np.concatenate([[True], np.diff(np.maximum.accumulate(time_s)) > 0])
    time_s, displacement = time_s[increasing], displacement[increasing]
    command = command[increasing] - NEUTRAL_PERCENT
    split = _rest_near_middle(time_s, command)
    return (
        (time_s[:split] - time_s[0], command[:split], displacement[:split]),
        (time_s[split:] - time_s[split], command[split:], displacement[split:]),
    )


def _rest_near_middle(time_s: np.ndarray, command: np.ndarray) -> int:
    """Return the sample nearest to the middle that has had no command for a while."""
    moving = np.flatnonzero(np.abs(command) > 1e-3)
    last_moving = np.searchsorted(moving, np.arange(time_s.size), side="right") - 1
    rest_duration_s = np.where(last_moving >= 0, time_s - time_s[moving[np.maximum(last_moving, 0)]], np.inf)
    rest_samples = np.flatnonzero(rest_duration_s > MIN_REST_S)
    return int(rest_samples[np.argmin(np.abs(rest_samples - time_s.size // 2))])


def _resample(half: Half, step_s: float) -> np.ndarray:
    """Return command and displacement on an even clock, shape [N, 2]: the command as it was in force."""
    time_s, command, displacement = half
    grid = np.arange(0.0, time_s[-1], step_s)
    in_force = command[np.searchsorted(time_s, grid, side="right") - 1]
    return np.column_stack([in_force, np.interp(grid, time_s, displacement)])

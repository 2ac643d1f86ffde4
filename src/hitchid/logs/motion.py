"""Correlation of the mean of one signal with the rate of another, over windows of all logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hitchid.logs.content import Content

WINDOW_S = 0.2  # s, for means and rates: several lags of a common valve (chosen)
WINDOW_SAMPLES = 3  # samples in a window, at least (chosen)
LAGS = (0, 1)  # windows, lags from command to motion (chosen)
MAX_STEP_RATIO = 10.0  # sampling times of the fastest channel; of one that decides the windows (chosen)
MAX_CHANNELS = 80  # channels compared, to limit the time with hundreds on a bus (chosen)


@dataclass(frozen=True)
class Windows:
    """Means and changes of every channel over the windows of all logs.

    Attributes:
        means: channel to its mean over each window, shape [W].
        rates: channel to its change per second over each window, shape [W].
        follows: whether a window follows the one before it in the same log, shape [W].
    """

    means: Mapping[str, np.ndarray]
    rates: Mapping[str, np.ndarray]
    follows: np.ndarray

    def correlation(self, commands: Sequence[np.ndarray], displacement: str) -> float:
        """Return the correlation of the means of commands, each of shape [W], with a displacement's rate.

        Each command has a gain of its own: of several it is the multiple correlation, which is positive.
        At a lag of zero or one window, whichever correlation is larger in magnitude.
        """
        rate, best = self.rates[displacement], 0.0
        for lag in LAGS:
            consecutive = self.follows[1:] if lag else slice(None)
            effect = rate[lag:][consecutive]
            causes = [command[: command.size - lag][consecutive] for command in commands]
            if effect.size <= 2 or min(map(np.ptp, (effect, *causes))) == 0:
                continue
            combined = causes[0]
            if len(causes) > 1:
                design = np.stack([*causes, np.ones_like(effect)], axis=1)
                combined = design @ np.linalg.lstsq(design, effect)[0]
            correlation = float(np.corrcoef(combined, effect)[0, 1])
            best = correlation if abs(correlation) > abs(best) else best
        return best


def windows(logs: Sequence[Content], names: Sequence[str]) -> Windows:
    """Return means and rates over windows of 0.2 s, or of three samples if that is longer.

    Every channel has a clock. At most 80 names are used.
    """
    names = names[:MAX_CHANNELS]
    means: dict[str, list[np.ndarray]] = {name: [] for name in names}
    rates: dict[str, list[np.ndarray]] = {name: [] for name in names}
    follows: list[np.ndarray] = []
    for content in logs:
        times = {name: np.asarray(content.channels[name].clock_s) for name in names}
        steps = {name: float(np.median(np.diff(times[name]))) for name in names}
        # Rare channels, such as a command logged on change, hold; they do not decide the windows.
        dense = [name for name in names if steps[name] <= MAX_STEP_RATIO * min(steps.values())]
        width = max(WINDOW_S, WINDOW_SAMPLES * max(steps[name] for name in dense))
        # Where a channel has no sample yet, its hold is not known; after its last one it goes on.
        begin = max(float(times[name][0]) for name in names)
        end = min(float(times[name][-1]) for name in dense)
        edges = begin + width * np.arange(int((end - begin) / width) + 1)
        if edges.size < 2:
            continue
        follows.append(np.arange(edges.size - 1) > 0)
        for name in names:
            time, values = times[name], content.channels[name].values
            time, values = np.append(time, max(time[-1], end)), np.append(values, values[-1])
            # Zero-order hold, to the end of the log: the integral is linear between samples.
            integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time))])
            means[name].append(np.diff(np.interp(edges, time, integral)) / width)
            rates[name].append(np.diff(np.interp(edges, time, values)) / width)
    if not follows:
        return Windows({}, {}, np.zeros(0, dtype=bool))
    return Windows(
        {name: np.concatenate(arrays) for name, arrays in means.items()},
        {name: np.concatenate(arrays) for name, arrays in rates.items()},
        np.concatenate(follows),
    )

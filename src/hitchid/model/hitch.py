"""The whole plant: one channel a direction, switched by the commands."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from hitchid.benchmark import Batch
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.modes import ACTIVE_FRACTION, Stroke, full_scales, mode_changes
from hitchid.precision import double_precision
from hitchid.record import COMMAND, DISPLACEMENT, Record
from hitchid.units import conversion_factor


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from: enough to repeat it, and to know which tests it has seen.

    Attributes:
        identification, validation, held_out: mode to the names of the tests that found the benchmark, that
            stopped the training, and that nothing has seen. Validation tests are identification tests too.
        seen: fingerprints of every record the identification used.
        cut_at: mode to the dead zone with which mixed cycles were cut into strokes; empty where none were.
        seed: the seed of every random draw.
        settings: what was asked for, as JSON can hold it.
        versions: package to version.
    """

    identification: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    validation: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    held_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seen: frozenset[str] = frozenset()
    cut_at: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    settings: Mapping[str, object] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Hitch:
    """A dual-mode grey box, or one with a single channel.

    Attributes:
        channels: mode to channel.
        step_s: sampling time, s.
        units: role to unit; what goes in and comes out of `simulate` is in these or converted to them.
        provenance: where the model comes from.
    """

    channels: Mapping[str, Channel]
    step_s: float
    units: Mapping[str, str]
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        """Freeze the mappings."""
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @double_precision
    def extrapolation(self, record: Record) -> tuple[str, ...]:
        """Tell in words where a free run leaves what the identification tests covered.

        Beyond a tenth of a range the compensator for free run has faded out and the benchmark alone answers.

        Args:
            record: as `simulate` takes it.

        Raises:
            InputError, SettingsError: as `simulate`.
        """
        own = self.adopt(record)
        found: dict[tuple[str, str], int] = {}

        def count(channel: Channel, batch: Batch) -> np.ndarray:
            rows = channel.simulate(batch)
            for name, outside in channel.outside(batch, rows).items():
                key = channel.mode, name
                found[key] = found.get(key, 0) + int(outside[0].sum())
            return np.asarray(rows)[0]

        self._over_strokes(own, count, measured=False)
        return tuple(
            f"{mode}: the {name} leaves what the tests covered, {self._covered(mode, name)}, in "
            f"{samples} of {len(own)} samples"
            for (mode, name), samples in found.items()
            if samples
        )

    def _covered(self, mode: str, name: str) -> str:
        channel = self.channels[mode]
        load = channel.benchmark.load or ""
        role = {"command": COMMAND[mode], "displacement": DISPLACEMENT, "load": load}[name]
        covered = getattr(channel.envelope, name)
        beyond = " beyond the dead zone" if name == "command" else ""
        ends = f"{float(covered.lowest):.4g} to {float(covered.highest):.4g}"
        return f"{ends} {self.units.get(role, '')}{beyond}"

    @property
    def dead_zones(self) -> dict[str, float]:
        """Mode to dead zone, in the command's unit."""
        return {mode: channel.dead_zone for mode, channel in self.channels.items()}

    @double_precision
    def simulate(self, record: Record, *, compensated: bool = True) -> np.ndarray:
        """Return the free run: displacement from the commands and the initial displacement alone.

        Where the mode changes, the channel that takes over starts at rest from where the other one ended.

        Args:
            record: supplies commands, and displacement for the mean of the first samples before motion.
            compensated: False leaves the compensators out.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: a command is effective that the model has no channel for.
            SettingsError: a unit is of another dimension than the model's.
        """

        def run(channel: Channel, batch: Batch) -> np.ndarray:
            rows = channel.simulate(batch) if compensated else channel.simulate_benchmark(batch)
            return np.asarray(rows)[0]

        return self._over_strokes(record, run, measured=False)

    @double_precision
    def predict(self, record: Record, *, horizon: int = 1) -> np.ndarray:
        """Return each sample predicted from the displacement measured `horizon` samples before and earlier.

        Within `horizon` samples of the start of a stroke, the prediction is from the stroke's start.

        Args:
            record: supplies commands and displacement.
            horizon: samples to look ahead, at least 1.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: the horizon is below 1, or as `simulate`.
            SettingsError: a unit is of another dimension than the model's.
        """
        if horizon < 1:
            raise InputError(f"horizon: required at least 1 sample, came {horizon}")

        def run(channel: Channel, batch: Batch) -> np.ndarray:
            return np.asarray(channel.predict(batch, (min(horizon, batch.command.shape[1]),)))[0, 0]

        return self._over_strokes(record, run, measured=True)

    def adopt(self, record: Record) -> Record:
        """Return a record on the model's clock and in the model's units.

        Raises:
            InputError: the record has no command for any channel, or one effective that no channel hears.
            SettingsError: a unit is of another dimension than the model's.
        """
        if not any(mode in record.modes for mode in self.channels):
            raise InputError(
                f"record '{record.name}' has commands for {' and '.join(record.modes)}; "
                f"the model has channels for {' and '.join(self.channels)}"
            )
        told = record.convert({role: unit for role, unit in self.units.items() if role in record.signals})
        on_clock = told if _same_clock(told.step_s, self.step_s, len(told)) else told.resample(self.step_s)
        scales = full_scales([record])
        for mode in record.modes:
            active = np.abs(record.command(mode)) > ACTIVE_FRACTION * scales[mode]
            if mode not in self.channels and np.any(active):
                raise InputError(
                    f"record '{record.name}': its {mode} command is not zero; the model has no {mode} channel"
                )
        return on_clock

    def _over_strokes(
        self, record: Record, run: Callable[[Channel, Batch], np.ndarray], *, measured: bool
    ) -> np.ndarray:
        """Run each stroke through its channel; where a mode ends the next one starts."""
        own = self.adopt(record)
        predicted = np.empty(len(own))
        for stroke in self._strokes(own):
            channel = self.channels[stroke.mode]
            part = own.slice(stroke.start, min(stroke.stop + 1, len(own)))
            first = stroke.start == 0
            start = (own.displacement if measured else predicted)[stroke.start]
            batch = channel.batch([part], None if first else [float(start)])
            new = slice(0 if first else 1, len(part))
            predicted[stroke.start : stroke.start + len(part)][new] = run(channel, batch)[new]
        unit = conversion_factor(self.units[DISPLACEMENT], record.unit, record.name)
        if own.step_s != record.step_s:
            predicted = np.interp(record.time_s, own.time_s, predicted)
        return predicted * unit

    def _strokes(self, record: Record) -> list[Stroke]:
        if len(self.channels) == 1:
            (mode,) = self.channels
            return [Stroke(mode, 0, len(record))]
        return mode_changes(record, self.dead_zones)


def _same_clock(step_s: float, wanted_s: float, samples: int) -> bool:
    return abs(step_s - wanted_s) * samples <= 0.05 * wanted_s

"""Models put together by hand, so that a test need not identify one."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hitchid.baselines.black_box import STEPS, BlackBox, IntegratingLstm
from hitchid.baselines.linear import Arx, LinearInputs
from hitchid.baselines.narx import Narx
from hitchid.baselines.output_error import OutputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import (
    Bands,
    Channel,
    EnsembleMember,
    Estimates,
    Hitch,
    PredictionSpread,
    Provenance,
    Rivals,
    Uncertainty,
)
from hitchid.model.load_filter import LoadFilter
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES, Compensator
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange, SignalRange
from hitchid.networks.speed_compensator import SIGNALS, SpeedCompensator, SpeedNetworks
from hitchid.structures import (
    CovariateScales,
    PhysicalModel,
    Scales,
    Scheduling,
    StaticNonlinearity,
    scheduled_quantities,
    structure_named,
)

UNITS = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
DIRECTIONS = {LIFTING: 1, LOWERING: -1}
DEAD_ZONES = {LIFTING: 0.35, LOWERING: 0.25}
GAINS = {LIFTING: 30.0, LOWERING: 20.0}
STEP_S = 0.01
VALUES = {
    "integrator": (),
    "integrator-first-order": (0.08,),
    "first-order-lag": (5.0,),
    "integrator-second-order": (18.0, 0.6),
}
HIDDEN, WINDOW, ERROR_STEP = 4, 10, 0.02
COVERED = {"command": (0.0, 0.5), "displacement": (50.0, 150.0), "load": (0.0, 0.0)}
MEMBERS, TANH_UNITS = 2, 3


def network(inputs, seed, *, trained=True):
    """Return a small LSTM; untrained, its output is zero, as that of a fresh one is."""
    fresh = Lstm.init(jax.random.key(seed), inputs, HIDDEN)
    if not trained:
        return fresh
    weights = np.random.default_rng(seed).normal(size=(1, HIDDEN))
    return eqx.tree_at(lambda n: n.head.weight, fresh, jnp.asarray(weights, jnp.float32))


def compensator(seed=0, *, trained=True):
    """Return a compensator for displacements around 100 mm."""
    centre = np.array([2.0, 0.2, 0.0, 100.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0])
    spread = np.array([1.0, 0.2, 0.1, 20.0, 0.1, 20.0, 10.0, 0.5, 0.1, 0.5])
    return Compensator(
        network(len(COMPENSATOR_FEATURES), seed, trained=trained),
        jnp.asarray(centre),
        jnp.asarray(spread),
        jnp.asarray(ERROR_STEP),
        WINDOW,
    )


def envelope(**covered):
    """Return the ranges of `COVERED`, or others: name to lowest and highest."""
    ranges = {**COVERED, **covered}
    signals = {name: SignalRange(*map(jnp.asarray, ends)) for name, ends in ranges.items()}
    signals["load"] = SignalRange(*(jnp.asarray([end]) for end in ranges["load"]))
    return OperatingRange(**signals)


def speed_compensator(seed=7, *, trained=True, size=1.0, direction=1, covered=None):
    """Return a compensator for free run; untrained it changes nothing, `size` scales its outputs."""
    rng = np.random.default_rng(seed)
    shapes = ((MEMBERS, TANH_UNITS, SIGNALS + 1), (MEMBERS, TANH_UNITS), (MEMBERS, TANH_UNITS))
    weights = [jnp.asarray(rng.standard_normal(shape)) for shape in shapes]
    return SpeedCompensator(
        networks=SpeedNetworks(*weights[:2], size * trained * weights[2]),
        command_scale=jnp.asarray(0.5),
        speed_scale=jnp.asarray(15.0),
        acceleration_scale=jnp.asarray(500.0),
        operating_range=covered or envelope(),
        sign=direction,
    )


SCALES = (1.2, 100.0, 60.0)  # A, mm, mm
CURVES = (0.1, 1.5, 2.0, 0.15, 0.02, 0.2, -0.1)


def scheduled(structure, curves=CURVES, scales=SCALES, centre=120.0, spread=25.0, **effects):
    """Return curves, and the effects of a pressure in bar: quantity to change per standard deviation."""
    pressure = CovariateScales(jnp.array([centre]), jnp.array([spread]))
    nonlinearity = StaticNonlinearity(
        jnp.array(curves), Scales(*(jnp.asarray(scale) for scale in scales), covariates=pressure)
    )
    quantities = scheduled_quantities(structure)
    rows = [[[effects.get(name, 0.0), effects.get(f"{name}_squared", 0.0)]] for name in quantities]
    return nonlinearity, Scheduling(("pressure",), quantities, jnp.array(rows))


# Noise, load and its length, transient and its time, drift: in mm and s.
LOAD_FILTERS = {
    LIFTING: LoadFilter(*map(jnp.asarray, (0.05, 0.02, 500.0, 0.1, 0.2, 0.02))),
    LOWERING: LoadFilter(*map(jnp.asarray, (0.08, 0.05, 90.0, 0.3, 0.1, 0.01))),
}


def channel(
    mode,
    structure="integrator",
    *,
    compensated=None,
    end_stop=None,
    dead_time_s=0.0,
    shape=False,
    free_run=None,
    covered=None,
    filtered=False,
):
    """Return a channel; `compensated` and `free_run`: None for no compensator, False for an untrained one."""
    curves = scheduled(structure_named(structure), gain=0.3, opening=0.05) if shape else (None, None)
    values = jnp.array([GAINS[mode], *VALUES[structure]])
    parts = {} if compensated is None else {"compensator": compensator(3, trained=compensated)}
    if free_run is not None:
        direction = DIRECTIONS[mode]
        parts["speed_compensator"] = speed_compensator(trained=free_run, direction=direction, covered=covered)
    is_bounded = free_run is not None or covered is not None
    parts["operating_range"] = (covered or envelope()) if is_bounded else OperatingRange.unbounded()
    return Channel(
        direction=mode,
        sign=DIRECTIONS[mode],
        dead_zone=DEAD_ZONES[mode],
        end_stop=end_stop,
        benchmark=PhysicalModel(structure_named(structure), values, jnp.asarray(dead_time_s), *curves),
        load_filter=LOAD_FILTERS[mode] if filtered else LoadFilter.none(),
        **parts,
    )


def black_box(hidden=5, members=2):
    """Return a black box that moves, of steps of two samples."""
    rng = np.random.default_rng(7)
    networks = [IntegratingLstm.init(rng, 2 * STEPS + 1, hidden, STEPS) for _ in range(members)]
    stacked = jax.tree.map(lambda *arrays: jnp.stack(arrays), *networks)
    head = jnp.asarray(rng.normal(size=stacked.head.shape), jnp.float32)
    stacked = eqx.tree_at(lambda network: network.head, stacked, head)
    return BlackBox(stacked, *map(np.asarray, (1.0, [0.0], [1.0], 100.0, 20.0, 0.005, 2)))


def comparison(mode):
    """Return the baselines and the paper's method beside a channel."""
    terms, coefficients = np.array([[1, 0], [-1, 0], [-1, 1]]), np.array([1.0, 0.2, -0.05])
    scaling = LinearInputs(*map(np.asarray, ([0.0], [1.0], 100.0, 20.0)))
    past, gains = np.array([1.5, -0.5]), np.array([[0.1, 0.05], [0.02, 0.0]])
    baselines = {
        "arx": Arx(scaling, past, gains),
        "oe": OutputError(scaling, past, gains, np.array(2), np.array(1)),
        "narx": Narx(scaling, terms, coefficients, np.array(20.0), np.array(0.5)),
        "lstm": black_box(),
    }
    return Rivals(baselines, channel(mode, "first-order-lag", compensated=True))


def hitch(structure="integrator", *, modes=(LIFTING, LOWERING), provenance=None, baselines=False, **options):
    """Return a model of one or two like channels at 100 Hz in mm and A."""
    channels = {mode: channel(mode, structure, **options) for mode in modes}
    compared = {mode: comparison(mode) for mode in modes} if baselines else {}
    return Hitch(channels, STEP_S, UNITS, provenance or Provenance(), rivals=compared)


def hitch_of(*channels, step_s=STEP_S, drift=0.0):
    """Return a model of given channels, in mm, A and bar."""
    units = {**UNITS, "pressure": "bar"}
    return Hitch({own.direction: own for own in channels}, step_s, units, drift=drift)


NOISE, FASTER, Q = 0.05, 1.1, (0.5, 1.0, 1.5, 2.0)
# Errors of 0.1 mm over a movement of 0.5 mm in one sample, of 0.4 mm over 5 mm in ten.
SPREAD = PredictionSpread(
    NOISE, 0.5, (1, 10), (0.5, 5.0), (0.1, 0.4), ((0.5, 1.0, 2.0, 3.0), (1.0, 2.0, 3.0, 4.0))
)


def with_bands(model, *modes):
    """Return a model with bands for some modes; as alternative a gain a tenth larger."""
    uncertainty = {}
    for mode in modes:
        gain, *rest = map(float, model.channels[mode].benchmark.parameter_vector)
        faster = EnsembleMember((FASTER * gain, *rest))
        bands = Bands((faster,), NOISE, (0.5, 0.8, 0.9, 0.95), Q, SPREAD, (4, 4))
        uncertainty[mode] = Uncertainty(Estimates((), (), (), 0, 0), bands=bands)
    return replace(model, uncertainty=uncertainty)

"""C99 code of a position controller, proved against the controller itself in closed loop with its model."""

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid._support.files import write_files
from hitchid.control import ControllerFile, HitchController
from hitchid.control.axis import REACHABLE, Axis
from hitchid.control.controller import REST_S, SMOOTHING_S, STILL_SHARE, TARGET_SPEED_S, WIDEST
from hitchid.control.drive import travel_of
from hitchid.errors import InputError
from hitchid.export.c_templates import CTemplates, Field, Precision, Typed, c_templates, valve_fields
from hitchid.export.constants import ModelConstants, channel_constants
from hitchid.export.verification import Compiler, ParityError, run_replay
from hitchid.logs import DIRECTIONS
from hitchid.model import Channel, Hitch
from hitchid.networks import OperatingRange
from hitchid.structures import opening_command

SAMPLES = 3000  # of the run that the code must repeat, 30 s; chosen: some ten targets
TARGET_S = (0.5, 4.0)  # shortest and longest time of a target, s
MISSING = 0.002  # share of samples where the sensor begins to be lost, for a tenth of a second
NOISE_SHARE = 1e-4  # of the range of displacement: standard deviation of the noise; chosen
STROKE_SHARE = 0.4  # of the range of displacement, half the distance of the farthest targets
# Of the largest current: rounding of the curves, which a division by the time squared amplifies, see `_step`.
TOLERANCES: dict[Precision, float] = {"double": 1e-7, "mixed": 1e-7, "single": 1e-2}
# Of samples in which a threshold may be passed a sample earlier or later. Rounding in single precision passes
# them otherwise more often, so that the same code is proved in double precision, too.
APART_SHARE = 1e-3

FIELDS = (  # of the state
    Field("reference", "real", (), "shaped"),
    Field("reference_speed", "real", (), "its speed"),
    Field("integral", "real", (), "speed that the integral part asks for"),
    Field("widening", "real", (), "factor on the outer window"),
    Field("smoothed", "real", (), "predicted position without most of its noise"),
    Field("drift", "real", (), "speed of the smoothed position beyond the predicted one"),
    Field("measured", "real", (), "last valid"),
    Field("target", "real", (), "last valid"),
    Field("target_speed", "real", (), "of a moving target"),
    Field("currents", "real", (2,), "last"),
    Field("holding", "int", (), "whether the hitch is held with closed valves"),
    Field("lost", "int", (), "whether the last measurement was missing"),
)


class ControllerRun(NamedTuple):
    """A run of a controller in closed loop with its model.

    Attributes:
        start: displacement before.
        inputs: target and measured displacement, NaN where there is none, shape [N, 2].
        currents: lifting and lowering, shape [N, 2].
    """

    start: float
    inputs: Float[np.ndarray, "n 2"]
    currents: Float[np.ndarray, "n 2"]


def controller_files(
    content: ControllerFile, model: Hitch, name: str, precision: Precision, compiler: Compiler | None
) -> tuple[dict[str, bytes], float | None]:
    """Return header and source of a controller, and its largest difference as a share of the largest current.

    Raises:
        InputError: the controller is for another model.
        ParityError: the compiled code differs from the controller.
    """
    check_controller(content, model)
    name = f"{name}_controller"
    files, _ = _rendered(content, name, precision)
    if compiler is None:
        return files, None
    run = controller_run(content.controller, model)
    # Rounding of single precision hides small mistakes; the same code in double precision shows them.
    if precision == "single":
        _proved(content, name, "double", compiler, run)
    return files, _proved(content, name, precision, compiler, run)


def check_controller(content: ControllerFile, model: Hitch) -> None:
    """Refuse a controller that was tuned for another model, with an InputError."""
    if content.digest != model.provenance.digest:
        raise InputError(
            f"controller: was tuned for model {content.digest[:12]}, expected "
            f"{model.provenance.digest[:12]}; tune one for this model"
        )


def _rendered(content: ControllerFile, name: str, precision: Precision) -> tuple[dict[str, bytes], bytes]:
    """Return the files of a controller, and the program that replays a run through them."""
    templates, more = controller_templates(
        content.controller, name, precision, content.digest, dict(content.units)
    )
    files = {
        f"{name}.h": templates.render("controller.h", **more).encode(),
        f"{name}.c": templates.render("controller.c", **more).encode(),
    }
    return files, templates.render("controller_replay.c", **more).encode()


def _proved(
    content: ControllerFile, name: str, precision: Precision, compiler: Compiler, run: ControllerRun
) -> float:
    """Return the largest difference of the compiled code in a run, as a share of the largest current.

    Raises:
        ParityError: the compiled code differs from the controller.
    """
    files, replay = _rendered(content, name, precision)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_files(folder, {**files, "replay.c": replay})
        program = folder / "replay"
        compiler.compile([folder / f"{name}.c", folder / "replay.c"], program)
        rows = run_replay([str(program)], np.array([len(run.inputs), run.start]), run.inputs, folder)
    return current_difference(content, rows[:, :2], run, precision)


def current_difference(
    content: ControllerFile, currents: Float[np.ndarray, "n 2"], run: ControllerRun, precision: Precision
) -> float:
    """Return the largest difference of generated currents in a run, as a share of the largest current.

    Raises:
        ParityError: in more samples than thresholds explain it is larger than rounding.
    """
    largest = max(axis.largest_command for axis in content.controller.axes)
    differences = np.max(np.abs(currents - run.currents), axis=1) / largest
    # A share of samples, not the largest difference: a valve that opens a sample later differs fully.
    share = float(np.mean(~(differences <= TOLERANCES[precision])))
    if share > APART_SHARE:
        raise ParityError(
            f"the generated controller differs by {np.max(differences):.2g} of the largest current in "
            f"{share:.1%} of the samples; nothing was written; please report this controller"
        )
    return float(np.max(differences))


def controller_templates(
    controller: HitchController, name: str, precision: Precision, digest: str, units: dict[str, str]
) -> tuple[CTemplates, dict[str, Any]]:
    """Return the templates of a controller, and what they name beside the numbers of its two models."""
    channels = []
    for number, (direction, axis) in enumerate(zip(DIRECTIONS, controller.axes, strict=True)):
        # A controller has no networks, whose trust would fall beyond the range of the tests.
        unbounded, dead_zone = OperatingRange.unbounded(), float(axis.model.dead_zone)
        channel = Channel(direction, axis.sign, dead_zone, None, axis.model.benchmark, unbounded)
        channels.append(channel_constants(number, channel, axis.model))
    constants = ModelConstants(tuple(channels), controller.step_s, 0.0, None, units, (), (), False, digest)
    step_s = controller.step_s
    axes = [_axis(controller, number) for number in range(len(channels))]
    owned = {
        channel.name: [
            *valve_fields(channel),
            Field("increments", "real", (len(axis["shares"]),), "travel of the last samples"),
        ]
        for channel, axis in zip(channels, axes, strict=True)
    }
    more = {
        "is_controller": True,
        "axes": axes,
        "fields": [Typed.of(field, "", name) for field in FIELDS],
        "channel_fields": {
            owner: [Typed.of(field, f"{owner}.", name) for field in fields] for owner, fields in owned.items()
        },
        "speed_share": float(controller.speed_share),
        "target_share": step_s / TARGET_SPEED_S,
        "smoothing_share": 2 * step_s / SMOOTHING_S,
        "drift_share": step_s / SMOOTHING_S**2,
        "still_share": STILL_SHARE,
        "widest": WIDEST,
        "narrowing": 0.5 ** (step_s / REST_S),
        "inner": float(controller.hold.inner),
        "outer": float(controller.hold.outer),
        "most_rise": float(controller.rate) * step_s,
        "reachable": REACHABLE,
    }
    return c_templates(constants, name, precision), more


def controller_run(controller: HitchController, model: Hitch) -> ControllerRun:
    """Return a run in closed loop with the model: steps, ramps, noise, a sensor that is lost."""
    rng = np.random.default_rng(0)
    low, high = travel_of(model)
    middle, width = (0.5 * (low + high), high - low) if high - low < 1e6 else (100.0, 75.0)
    targets = _targets(middle, STROKE_SHARE * width, controller.step_s, rng)
    lost = np.convolve(rng.random(SAMPLES) < MISSING, np.ones(round(0.1 / controller.step_s)))[:SAMPLES] > 0
    state, plant = controller.initial_state(middle), model.init_state(middle)
    displacement, inputs, currents = middle, [], []
    for target, is_lost in zip(targets, lost, strict=True):
        measured = np.nan if is_lost else displacement + NOISE_SHARE * width * rng.standard_normal()
        state, current = controller.step(state, float(target), float(measured))
        plant, after = model.step(plant, np.asarray(current))
        displacement = float(after)
        inputs.append((target, measured))
        currents.append(np.asarray(current))
    return ControllerRun(middle, np.array(inputs), np.array(currents))


def _targets(middle: float, reach: float, step_s: float, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Return steps and ramps about the middle, with some targets that are not finite."""
    targets = np.empty(0)
    last = middle
    while targets.size < SAMPLES:
        count = round(float(rng.uniform(*TARGET_S)) / step_s)
        # Half of them near the middle, so that some changes are small enough for the hold window.
        goal = middle + float(rng.uniform(-reach, reach)) * float(rng.choice([1.0, 0.1]))
        is_ramp = rng.random() < 0.3
        piece = np.linspace(last, goal, count) if is_ramp else np.full(count, goal)
        targets, last = np.concatenate([targets, piece]), goal
    targets = targets[:SAMPLES]
    targets[rng.random(SAMPLES) < MISSING] = np.nan
    return targets


def _axis(controller: HitchController, number: int) -> dict[str, Any]:
    """Return what the templates name of one direction."""
    axis: Axis = controller.axes[number]
    gains, step_s = controller.gains[number], controller.step_s
    samples = float(axis.dead_time_samples)
    return {
        "gain": float(axis.model.benchmark.gain),
        "largest": axis.largest_command,
        "largest_effective": max(axis.largest_command - float(axis.model.dead_zone), 0.0),
        "opening": float(opening_command(axis.model.benchmark, axis.model.dead_zone)),
        "shares": tuple(float(np.clip(samples - index, 0.0, 1.0)) for index in range(axis.buffer)),
        "dead_time_s": samples * step_s,
        "deceleration": float(controller.deceleration[number]),
        "lag_s": float(controller.lags_s[number]),
        "crossing": float(controller.crossing_speed[number]),
        "proportional": float(gains.proportional),
        "integral": float(gains.integral),
        "speed": float(gains.speed),
        "acceleration_gain": float(gains.acceleration),
    }

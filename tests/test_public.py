"""What users call from Python: logs in every form, without x64 switched on, with wrong arguments."""

import json
import subprocess
import sys

import numpy as np
import pytest

import handmade
import hitchid
from hitchid.identification.config import DEFAULT_STRUCTURES, SEARCHES, IdentificationConfig
from hitchid.model import save

CHILD = """
import json, sys, traceback
from functools import partial
from pathlib import Path
import jax
import jax.numpy as jnp
import numpy as np
import hitchid
from hitchid.bench.virtual_campaign import write_campaign
from hitchid.control.next_test import ExcitationLimits, design
from hitchid.model import save
from hitchid.cli.simulated_log import simulate_log
from hitchid.validation import compare

folder, logs, out = map(Path, sys.argv[1:])
campaign = hitchid.read(logs)
record = campaign.records[0]
model = hitchid.load(folder)
channel = model.channels["lifting"]
benchmark = channel.benchmark
batch = channel.batch([record], [1.0])
state = model.init_state(120.1)


def stepped():
    after = state
    for _ in range(3):
        after, displacement = model.step(after, [0.55, 0.0], 120.1)
    return after, displacement, model.unpack_state(after)


calls = {
    "load": lambda: [c for c in jax.tree.leaves(hitchid.load(folder).channels["lifting"].benchmark)],
    "initial": lambda: model.init_state(120.1),
    "step": stepped,
    "simulate": lambda: model.simulate(record).displacement,
    "predict": lambda: model.predict(record, horizon=3),
    "band": lambda: model.simulate(record).band(),
    "batch": lambda: channel.batch([record], [1.0]),
    "channel": lambda: (channel.simulate(batch), channel.simulate_benchmark(batch)),
    "closed loop": lambda: channel.simulate_closed_loop(batch),
    "channel, predict": lambda: channel.predict(batch, (1, 5)),
    "outside": lambda: channel.out_of_range(batch, batch.displacement),
    "response": lambda: benchmark.response(batch.command, 0.01),
    "discretised": lambda: benchmark.discretised(60.0),
    "row": lambda: benchmark.with_parameter_vector(benchmark.parameter_vector),
    "to_scipy": lambda: [(g.A, g.B) for g in (model.to_scipy("lifting", h) for h in (0.001, 60.0))],
    "to_control": lambda: model.to_control("lifting", 0.001).A,
    "speed": lambda: model.speed([0.3, 0.5], "lifting"),
    "inverse_table": lambda: model.inverse_table("lifting", [1.0, 2.0]).command,
    "with_parameters": lambda: model.with_parameters(lifting={"gain": 25}).simulate(record).displacement,
    "validate": lambda: hitchid.validate(model, campaign).metrics,
    "bands": lambda: model.uncertainty["lifting"].bands.half_width(0.9, 3, np.ones(2)),
}


def numbers(value):
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        return np.concatenate([np.zeros(0), *map(numbers, value)])
    if isinstance(value, (str, type(None))):
        return np.zeros(0)
    if isinstance(value, (int, float, np.ndarray, np.generic, jax.Array)):
        assert getattr(value, "dtype", None) != np.float32 or np.ndim(value) == 3, value  # a network's state
        return np.ravel(np.asarray(value, float))
    return numbers(jax.tree.leaves(value))


def apart(call):
    assert not jax.config.jax_enable_x64
    single = numbers(call())
    with jax.enable_x64(True):
        double = numbers(call())
    return float(np.max(np.abs(single - double) / np.maximum(np.abs(double), 1e-3), initial=0.0))


def of(call, *values):
    return [lambda value=value: call(value) for value in values]


def using(call, *options):
    return [lambda own=own: call(**own) for own in options]


frame = record.to_dataframe()
from_frame, frames = hitchid.Record.from_dataframe, hitchid.Campaign.from_dataframes
units = {"displacement": "mm", "lifting_command": "A"}
signals = {"displacement": np.zeros(3), "lifting_command": np.zeros(3)}
wrong = {
    'a campaign as hitchid.read("logs")': [
        *of(hitchid.identify, "logs"),
        *of(hitchid.identify_many, "logs", [campaign, "logs"]),
        *of(hitchid.cross_validate, "logs"),
        lambda: hitchid.validate(model, "logs"),
        lambda: compare([model, model], "logs"),
    ],
    "a model as hitchid.load": [
        *of(design, "model"),
        lambda: hitchid.validate("model", campaign),
        *of(lambda models: compare(models, campaign), [model, None], model),
        lambda: simulate_log("model", logs, out),
        lambda: save("model", out),
    ],
    "there is no structure 'spring'; expected one of": [
        *of(lambda form: hitchid.identify(campaign, structure=form), {"lifting": "spring"}, "spring"),
    ],
    "search: expected one of whale, differential-evolution, multi-start": [
        *of(lambda search: hitchid.identify(campaign, search=search), "particles", 3),
    ],
    "structure: expected": [lambda: hitchid.identify(campaign, structure=["integrator"])],
    "expected arguments": [
        *using(partial(hitchid.identify, campaign), {"structures": "integrator"}, {"epochs": 10}),
        *(hitchid.identify, hitchid.identify_many, hitchid.read, hitchid.load, model.save, model.simulate),
        lambda: hitchid.cross_validate(campaign, k=5),
        lambda: hitchid.read(logs, sep=";"),
        lambda: hitchid.validate(campaign),
        lambda: hitchid.validate(model, campaign, horizon=10),
        lambda: hitchid.compare(campaign=campaign),
        lambda: hitchid.load(folder, "r"),
        lambda: hitchid.save(model),
        lambda: model.save(out, overwrite=True),
        lambda: model.simulate(record, dt=0.01),
        lambda: model.predict(record, steps=10),
        lambda: model.with_parameters(gain=25),
        lambda: hitchid.export.to_c(model),
    ],
    "signal: expected one of displacement, lifting_command, lowering_command": [
        *of(record.__getitem__, "position", 0),
    ],
    "a record, a DataFrame, the path of a log, columns, or an array": [
        *of(model.simulate, campaign, None, model),
    ],
    "a record, a DataFrame, or the path of a log": [
        *of(model.predict, campaign), lambda: model.band(3, horizon=1),
    ],
    "files and folders of logs, DataFrames, or records": [*of(hitchid.read, [record, frame], None, [3])],
    "expected one record": [lambda: model.simulate(logs), lambda: model.predict(logs)],
    "a mapping for DataFrames": [lambda: hitchid.read(frame, signals="campaign.toml")],
    "one of lifting, lowering, got str 'up'": [
        lambda: hitchid.identify(campaign, structure={"up": "integrator"}),
        lambda: hitchid.identify(campaign, dead_zones={"up": 0.1}),
        *of(record.command, "up"),
        *of(campaign.segmented, {"up": 0.1}),
        *using(campaign.plot, {"direction": "up"}),
        *of(model.plot_bode, "up"),
        *of(model.plot_step_response, "up"),
        lambda: write_campaign(out, directions=["up"]),
    ],
    "expected": [
        *using(
            partial(hitchid.identify, campaign),
            *({"structure": {"lifting": 3}}, {"dead_zones": {"lifting": [0.1]}}, {"training": "none"}),
            *({"rivals": 3}, {"drift": "yes"}, {"seed": -1}, {"seed": 1.5}),
        ),
        *of(hitchid.read, 3, [3]),
        lambda: hitchid.read(logs, signals=3),
        *of(hitchid.load, None),
        *of(hitchid.Campaign.of, "logs"),
        lambda: hitchid.Campaign.of([record], test_patterns="*"),
        *of(lambda step_s: hitchid.Record("a", step_s, signals, units), [0.01], "0.01"),
        lambda: hitchid.Record("a", 0.01, [0.0], units),
        lambda: hitchid.Record("a", 0.01, {**signals, "displacement": ["x", "y", "z"]}, units),
        lambda: hitchid.Record("a", 0.01, signals, {}),
        lambda: hitchid.Record("a", 0.01, signals, units, kind="up"),
        *of(record.resample, "1", 1e-12),
        *of(record.trim, "0"),
        *of(record.low_pass, "5"),
        *of(record.decimate, 2.5),
        *of(record.detrend, 3),
        *of(record.convert, ["mm"]),
        *of(campaign.__getitem__, 2.5, None, slice(None, None, 0), np.array(1)),
        *of(from_frame, 3),
        *using(partial(from_frame, frame), {"name": 3}, {"signals": 3}),
        *using(partial(from_frame, frame), {"units": 3}, {"units": {"time_s": 3}}),
        *of(frames, 3),
        lambda: frames([frame], kinds=3),
        *of(model.simulate, frame[["time_s", "displacement_mm"]]),
        *of(
            lambda commands: model.simulate(commands, step_s=0.01, initial=120.0),
            *([[0.5], [0.5, 0.0]], None, np.full(5, 1e300), np.ma.masked_array(np.ones(5), mask=True)),
        ),
        *using(
            partial(model.simulate, np.zeros(5)),
            *({"step_s": "1 ms", "initial": 120.0}, {"step_s": 0.01, "initial": "120"}),
            *({"step_s": 0.01, "initial": [120.0, "x"]}, {"step_s": 0.01}),
        ),
        lambda: model.simulate(record, initial=120.0, load=[1.0]),
        lambda: model.speed([1.0, 2.0, 3.0], "lifting", displacement=[1.0, 2.0]),
        *of(lambda horizon: model.predict(record, horizon=horizon), "1", 0),
        lambda: model.predictions(record, ()),
        *of(model.simulate(record).band, "0.9"),
        lambda: model.band(record, horizon=1.5),
        *of(model.command_thresholds, "A"),
        *of(model.init_state, "120", [120.0], float("nan")),
        *of(
            lambda commands: model.step(state, commands),
            *(0.5, [0.5], [0.5, 0.0, 120.0], jnp.zeros(3), np.zeros((1, 2)), ["up", "down"]),
        ),
        *of(lambda measured: model.step(state, [0.5, 0.0], measured), [120.0], "120"),
        *of(
            lambda own: model.step(own, [0.5, 0.0]),
            *(120.0, state._replace(numbers=state.numbers[1:])),
        ),
        lambda: jax.jit(model.step)(state, jnp.zeros(3)),
        *of(model.unpack_state, 120.0),
        *of(channel.batch, "logs"),
        *of(lambda step_s: model.to_scipy("lifting", step_s), "1 ms", 0.0),
        *of(lambda step_s: model.to_control("lifting", step_s), [0.001]),
        *of(lambda command: model.to_control("lifting", command=command), "0.5", 0.1),
        *of(lambda commands: model.speed(commands, "lifting"), "0.5", [0.5, None]),
        lambda: model.speed(0.5, "lifting", load=100.0),
        *of(lambda speeds: model.inverse_table("lifting", speeds), [-1.0], [[1.0]]),
        *of(model.inverse_table("lifting", 1.0).to_csv, 3),
        *of(
            lambda values: model.with_parameters(lifting=values),
            *(25, {"gain": "25"}, {"gain": 0}, {"gians": 25}, np.ones(2)),
        ),
        lambda: model.parameters["lifting", "gians"],
        *using(partial(design, model), {"limits": 3}, {"limits": ExcitationLimits(highest="1")}),
        lambda: design(model, "up"),
        *of(write_campaign, 3),
        lambda: write_campaign(out, 3),
        *of(lambda tests: write_campaign(out, tests=tests), 20, {"prbs": "20"}),
        lambda: simulate_log(model, 3, out),
    ],
    "matplotlib axes, got": [
        *of(record.plot, "axes"),
        *of(campaign.plot, 3),
        *of(model.plot, 3),
        lambda: model.plot_bode(axes=[record]),
        lambda: model.plot_step_response(commands=[0.5], axes=(1, 2, 3, 4)),
    ],
    "commands: expected": [
        *using(model.plot_step_response, {}, {"commands": [-0.5]}, {"commands": ["0.5"]}),
    ],
    "frequency_hz: expected": [
        *using(model.plot_bode, {"frequency_hz": [0.0]}, {"frequency_hz": "1 Hz"}),
    ],
    "unit 'millimetre' is not known; expected one of A, mA": [
        lambda: hitchid.Record("a", 0.01, signals, {**units, "displacement": "millimetre"}),
        lambda: record.convert({"displacement": "millimetre"}),
    ],
}


def outcome(call):
    try:
        call()
    except hitchid.HitchError as error:
        return str(error)
    except Exception:
        return traceback.format_exc()
    return "took it"


print(json.dumps({
    "apart": {name: apart(call) for name, call in calls.items()},
    "pole": [
        model.to_scipy("lifting", 0.001).A.ravel().tolist(),
        model.to_scipy("lifting", 60.0).B.ravel().tolist(),
    ],
    "said": [(word, outcome(call)) for word, attempts in wrong.items() for call in attempts],
    "left": out.exists(),
}))
"""


@pytest.fixture(scope="module")
def surface(bench_folder, tmp_path_factory):
    """Return what a process without x64 computed and refused."""
    place = tmp_path_factory.mktemp("public")
    save(handmade.with_bands(handmade.hitch(), "lifting", "lowering"), place / "model")
    command = [sys.executable, "-c", CHILD, str(place / "model"), str(bench_folder), str(place / "out")]
    done = subprocess.run(command, capture_output=True, text=True)  # noqa: S603
    assert done.returncode == 0, done.stderr
    assert "truncated to dtype float32" not in done.stderr
    return json.loads(done.stdout)


def test_every_call_computes_in_double_precision(surface):
    assert {name: apart for name, apart in surface["apart"].items() if apart > 1e-12} == {}


def test_an_integrator_handed_over_has_its_pole_at_one(surface):
    pole, step = surface["pole"]
    assert pole == [1.0]
    assert step == pytest.approx([60.0 * handmade.GAINS["lifting"]], rel=1e-15)


@pytest.mark.parametrize(("whole", "known"), [(hitchid, "identify"), (handmade.hitch(), "simulate")])
def test_an_unknown_name_is_answered_by_those_there_are(whole, known):
    with pytest.raises(AttributeError, match=f"no attribute 'fit'; expected one of .*{known}"):
        whole.fit  # noqa: B018
    assert not hasattr(whole, "fit")


def test_what_does_not_fit_is_refused_where_it_enters(surface):
    assert [(word, said) for word, said in surface["said"] if word not in said or "Traceback" in said] == []
    assert not surface["left"]


# --- one log in every form in which a user has it -----------------------------------------------------------


@pytest.fixture
def log(bench_folder):
    """Return the path of a lifting log."""
    return bench_folder / "lifting-01.csv"


def test_a_record_gives_its_signals_by_name(log):
    (record,) = hitchid.read(log)
    assert "displacement" in record
    assert "pressure" not in record
    np.testing.assert_array_equal(record["displacement"], record.displacement)
    with pytest.raises(TypeError, match="not iterable"):
        iter(record)


def test_tables_and_records_are_read_as_files_are(log):
    campaign = hitchid.read(log)
    (record,) = campaign
    frame = record.to_dataframe()
    for given in (frame, {"lifting-01": frame}, [frame], record, [record], campaign):
        (read,) = hitchid.read(given)
        np.testing.assert_array_equal(read.displacement, record.displacement)
        assert (read.kind, read.step_s) == (record.kind, record.step_s)


def test_a_log_is_simulated_from_its_path_and_its_table(log):
    (record,) = hitchid.read(log)
    model = handmade.hitch()
    run = model.simulate(record)
    for given in (record.to_dataframe(), log, str(log)):
        np.testing.assert_array_equal(model.simulate(given).displacement, run.displacement)
        np.testing.assert_array_equal(model.predict(given, horizon=5), model.predict(record, horizon=5))


def test_a_simulation_is_drawn_over_its_commands(log):
    (record,) = hitchid.read(log)
    run = handmade.hitch().simulate(record)
    displacement, commands = run.plot()
    (curve,) = displacement.get_lines()
    np.testing.assert_array_equal(curve.get_ydata(), run.displacement)
    drawn = {line.get_label(): line.get_ydata() for line in commands.get_lines()}
    np.testing.assert_array_equal(drawn["lifting command"], record["lifting_command"])


def test_structures_and_searches_have_names():
    for name, search in SEARCHES.items():
        assert IdentificationConfig.of(search=name).search == search
    both = IdentificationConfig.of(structure="integrator").specs
    assert {spec.structure.name for spec in both.values()} == {"integrator"}
    assert IdentificationConfig.of(structure="automatic").specs == DEFAULT_STRUCTURES


def test_packages_come_with_the_first_import():
    assert hitchid.export.to_c.__module__ == "hitchid.export.c99"

"""What users call from Python, in a process of its own: without x64 switched on, and with wrong arguments."""

import json
import subprocess
import sys

import pytest

import handmade
import hitchid
from hitchid.model import save

CHILD = """
import json, sys, traceback
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


units = {"displacement": "mm", "lifting_command": "A"}
signals = {"displacement": np.zeros(3), "lifting_command": np.zeros(3)}
wrong = {
    'a campaign as hitchid.read("logs")': [
        lambda: hitchid.identify("logs"),
        lambda: hitchid.identify_many("logs"),
        lambda: hitchid.identify_many([campaign, "logs"]),
        lambda: hitchid.validate(model, "logs"),
        lambda: hitchid.cross_validate("logs"),
        lambda: compare([model, model], "logs"),
    ],
    "a model as hitchid.load": [
        lambda: hitchid.validate("model", campaign),
        lambda: compare([model, None], campaign),
        lambda: compare(model, campaign),
        lambda: design("model"),
        lambda: simulate_log("model", logs, out),
        lambda: save("model", out),
    ],
    "there is no structure 'spring'; expected one of": [
        lambda: hitchid.identify(campaign, structure={"lifting": "spring"}),
        lambda: hitchid.identify(campaign, structure="spring"),
    ],
    "search: expected one of whale, differential-evolution, multi-start": [
        lambda: hitchid.identify(campaign, search="particles"),
        lambda: hitchid.identify(campaign, search=3),
    ],
    "structure: expected": [lambda: hitchid.identify(campaign, structure=["integrator"])],
    "expected arguments": [
        lambda: hitchid.identify(campaign, structures="integrator"),
        lambda: hitchid.identify(campaign, epochs=10),
        lambda: hitchid.identify(),
        lambda: hitchid.identify_many(),
        lambda: hitchid.cross_validate(campaign, k=5),
        lambda: hitchid.read(),
        lambda: hitchid.read(logs, sep=";"),
        lambda: hitchid.validate(campaign),
        lambda: hitchid.validate(model, campaign, horizon=10),
        lambda: hitchid.compare(campaign=campaign),
        lambda: hitchid.load(),
        lambda: hitchid.load(folder, "r"),
        lambda: hitchid.save(model),
        lambda: model.save(),
        lambda: model.save(out, overwrite=True),
        lambda: model.simulate(),
        lambda: model.simulate(record, dt=0.01),
        lambda: model.predict(record, steps=10),
        lambda: model.with_parameters(gain=25),
        lambda: hitchid.export.to_c(model),
    ],
    "signal: expected one of displacement, lifting_command, lowering_command": [
        lambda: record["position"],
        lambda: record[0],
    ],
    "a record, a DataFrame, the path of a log, columns, or an array": [
        lambda: model.simulate(campaign),
        lambda: model.simulate(None),
        lambda: model.simulate(model),
    ],
    "a record, a DataFrame, or the path of a log": [
        lambda: model.predict(campaign),
        lambda: model.band(3, horizon=1),
    ],
    "files and folders of logs, DataFrames, or records": [
        lambda: hitchid.read([record, record.to_dataframe()]),
        lambda: hitchid.read(None),
        lambda: hitchid.read([3]),
    ],
    "expected one record": [lambda: model.simulate(logs), lambda: model.predict(logs)],
    "a mapping for DataFrames": [lambda: hitchid.read(record.to_dataframe(), signals="campaign.toml")],
    "one of lifting, lowering, got str 'up'": [
        lambda: hitchid.identify(campaign, structure={"up": "integrator"}),
        lambda: hitchid.identify(campaign, dead_zones={"up": 0.1}),
        lambda: record.command("up"),
        lambda: campaign.segmented({"up": 0.1}),
        lambda: campaign.plot(direction="up"),
        lambda: model.plot_bode("up"),
        lambda: model.plot_step_response("up"),
        lambda: write_campaign(out, directions=["up"]),
    ],
    "expected": [
        lambda: hitchid.identify(campaign, structure={"lifting": 3}),
        lambda: hitchid.identify(campaign, dead_zones={"lifting": [0.1]}),
        lambda: hitchid.identify(campaign, training="none"),
        lambda: hitchid.identify(campaign, rivals=3),
        lambda: hitchid.identify(campaign, drift="yes"),
        lambda: hitchid.identify(campaign, seed=-1),
        lambda: hitchid.identify(campaign, seed=1.5),
        lambda: hitchid.read(3),
        lambda: hitchid.read([3]),
        lambda: hitchid.read(logs, signals=3),
        lambda: hitchid.load(None),
        lambda: hitchid.Campaign.of("logs"),
        lambda: hitchid.Campaign.of([record], test_patterns="*"),
        lambda: hitchid.Record("a", [0.01], signals, units),
        lambda: hitchid.Record("a", "0.01", signals, units),
        lambda: hitchid.Record("a", 0.01, [0.0], units),
        lambda: hitchid.Record("a", 0.01, {**signals, "displacement": ["x", "y", "z"]}, units),
        lambda: hitchid.Record("a", 0.01, signals, {}),
        lambda: hitchid.Record("a", 0.01, signals, units, kind="up"),
        lambda: record.resample("1"),
        lambda: record.trim("0"),
        lambda: record.low_pass("5"),
        lambda: record.decimate(2.5),
        lambda: record.detrend(3),
        lambda: campaign[2.5],
        lambda: campaign[None],
        lambda: hitchid.Record.from_dataframe(3),
        lambda: hitchid.Record.from_dataframe(record.to_dataframe(), name=3),
        lambda: hitchid.Record.from_dataframe(record.to_dataframe(), signals=3),
        lambda: hitchid.Record.from_dataframe(record.to_dataframe(), units=3),
        lambda: hitchid.Record.from_dataframe(record.to_dataframe(), units={"time_s": 3}),
        lambda: hitchid.Campaign.from_dataframes(3),
        lambda: hitchid.Campaign.from_dataframes([record.to_dataframe()], kinds=3),
        lambda: record.convert(["mm"]),
        lambda: model.simulate(record.to_dataframe()[["time_s", "displacement_mm"]]),
        lambda: model.simulate([[0.5], [0.5, 0.0]], step_s=0.01, initial=120.0),
        lambda: model.simulate(np.zeros(5), step_s="1 ms", initial=120.0),
        lambda: model.simulate(np.zeros(5), step_s=0.01, initial="120"),
        lambda: model.simulate(np.zeros(5), step_s=0.01, initial=[120.0, "x"]),
        lambda: model.simulate(np.zeros(5), step_s=0.01),
        lambda: model.simulate(record, initial=120.0, load=[1.0]),
        lambda: model.simulate(None, step_s=0.01, initial=120.0),
        lambda: model.simulate(np.full(5, 1e300), step_s=0.01, initial=120.0),
        lambda: model.simulate(np.ma.masked_array(np.ones(5), mask=True), step_s=0.01, initial=120.0),
        lambda: record.resample(1e-12),
        lambda: campaign[::0],
        lambda: campaign[np.array(1)],
        lambda: model.with_parameters(lifting=np.ones(2)),
        lambda: model.speed([1.0, 2.0, 3.0], "lifting", displacement=[1.0, 2.0]),
        lambda: model.predict(record, horizon="1"),
        lambda: model.predict(record, horizon=0),
        lambda: model.predictions(record, ()),
        lambda: model.simulate(record).band("0.9"),
        lambda: model.band(record, horizon=1.5),
        lambda: model.command_thresholds("A"),
        lambda: model.init_state("120"),
        lambda: model.init_state([120.0]),
        lambda: model.init_state(float("nan")),
        lambda: model.step(state, 0.5),
        lambda: model.step(state, [0.5]),
        lambda: model.step(state, [0.5, 0.0, 120.0]),
        lambda: model.step(state, jnp.zeros(3)),
        lambda: model.step(state, np.zeros((1, 2))),
        lambda: model.step(state, ["up", "down"]),
        lambda: model.step(state, [0.5, 0.0], [120.0]),
        lambda: model.step(state, [0.5, 0.0], "120"),
        lambda: model.step(120.0, [0.5, 0.0]),
        lambda: model.step(state._replace(numbers=state.numbers[1:]), [0.5, 0.0]),
        lambda: jax.jit(model.step)(state, jnp.zeros(3)),
        lambda: model.unpack_state(120.0),
        lambda: channel.batch("logs"),
        lambda: model.to_scipy("lifting", "1 ms"),
        lambda: model.to_scipy("lifting", 0.0),
        lambda: model.to_control("lifting", [0.001]),
        lambda: model.to_control("lifting", command="0.5"),
        lambda: model.to_control("lifting", command=0.1),
        lambda: model.speed("0.5", "lifting"),
        lambda: model.speed([0.5, None], "lifting"),
        lambda: model.speed(0.5, "lifting", load=100.0),
        lambda: model.inverse_table("lifting", [-1.0]),
        lambda: model.inverse_table("lifting", [[1.0]]),
        lambda: model.inverse_table("lifting", 1.0).to_csv(3),
        lambda: model.with_parameters(lifting=25),
        lambda: model.with_parameters(lifting={"gain": "25"}),
        lambda: model.with_parameters(lifting={"gain": 0}),
        lambda: model.with_parameters(lifting={"gians": 25}),
        lambda: model.parameters["lifting", "gians"],
        lambda: design(model, limits=3),
        lambda: design(model, limits=ExcitationLimits(highest="1")),
        lambda: design(model, "up"),
        lambda: write_campaign(3),
        lambda: write_campaign(out, 3),
        lambda: write_campaign(out, tests=20),
        lambda: write_campaign(out, tests={"prbs": "20"}),
        lambda: simulate_log(model, 3, out),
    ],
    "matplotlib axes, got": [
        lambda: record.plot("axes"),
        lambda: campaign.plot(3),
        lambda: model.plot(3),
        lambda: model.plot_bode(axes=[record]),
        lambda: model.plot_step_response(commands=[0.5], axes=(1, 2, 3, 4)),
    ],
    "commands: expected": [
        lambda: model.plot_step_response(),
        lambda: model.plot_step_response(commands=[-0.5]),
        lambda: model.plot_step_response(commands=["0.5"]),
    ],
    "frequency_hz: expected": [
        lambda: model.plot_bode(frequency_hz=[0.0]),
        lambda: model.plot_bode(frequency_hz="1 Hz"),
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


def test_every_call_computes_in_double_precision_whatever_jax_is_set_to(surface):
    assert {name: apart for name, apart in surface["apart"].items() if apart > 1e-12} == {}


def test_an_integrator_handed_over_has_its_pole_at_one_and_the_gain_of_its_step(surface):
    pole, step = surface["pole"]
    assert pole == [1.0]
    assert step == pytest.approx([60.0 * handmade.GAINS["lifting"]], rel=1e-15)


@pytest.mark.parametrize(("whole", "known"), [(hitchid, "identify"), (handmade.hitch(), "simulate")])
def test_a_name_that_is_not_there_is_answered_by_those_that_are(whole, known):
    with pytest.raises(AttributeError, match=f"no attribute 'fit'; expected one of .*{known}"):
        whole.fit  # noqa: B018
    assert not hasattr(whole, "fit")


def test_what_does_not_fit_is_refused_where_it_enters(surface):
    assert [(word, said) for word, said in surface["said"] if word not in said or "Traceback" in said] == []
    assert not surface["left"]

"""The advised test stays within its limits and brings what is said of it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handmade import hitch as made_up
from hitchid.bench.excitation import precompensated
from hitchid.control.next_test import (
    CANDIDATES,
    MAX_PROPOSALS,
    ExcitationLimits,
    Proposal,
    command_of,
    design,
    write_command,
)
from hitchid.errors import InputError, OutputError
from hitchid.estimation import MultiStart
from hitchid.identification.direction import operating_range_of
from hitchid.identification.phase1 import identify_benchmark
from hitchid.logs.record import LIFTING, LOWERING, Record
from hitchid.model import Channel, Hitch, Uncertainty
from hitchid.networks.operating_range import SignalRange
from hitchid.structures import Batch, ModelSpec, structure_named
from hitchid.uncertainty import NO_ERROR, DeadZoneError, information_of
from hitchid.uncertainty.influence import standard_errors, standard_errors_with
from truth import STEP_S, held, levels

UNITS = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A"}
ZONE, TESTS, SAMPLES, LASTING_S = 0.35, 8, 251, 2.5
LARGE_MM = 1000.0
PLANTS = {LIFTING: (30.0, 0.2), LOWERING: (20.0, 0.08)}
START_MM = 100.0


def lagged(gain, time_constant):  # K / (s (τ s + 1))
    return [gain], [time_constant, 1.0, 0.0]


def identified(mode, dead_zone=NO_ERROR):
    """Return a channel identified from tests of a made-up plant, and what is known of it."""
    rng, records = np.random.default_rng(0), []
    for number in range(TESTS):
        command = levels(rng, SAMPLES, low=0.1, high=0.6)
        travel = held(*lagged(*PLANTS[mode]), command) + 0.1 * rng.standard_normal(SAMPLES)
        signals = {"displacement": START_MM + travel, f"{mode}_command": precompensated(command, ZONE)}
        records.append(Record(f"{number}", STEP_S, signals, {role: UNITS[role] for role in signals}))
    batch = Batch.of(records, mode, dead_zone=ZONE, sign=1, initial=[START_MM] * TESTS)
    form = ModelSpec(structure_named("integrator-first-order"))
    search, units = MultiStart(60, starts=1), {"x": "mm", "u": "A"}
    result = identify_benchmark(batch, form, search, 0, units=units, dead_zone=dead_zone)
    information = information_of(result.fit.objective, result.fit.position, result.influence)
    channel = Channel(mode, 1, ZONE, None, result.benchmark, operating_range_of(batch, ()))
    uncertainty = Uncertainty(result.assessment, information=information)
    return (channel if mode == LIFTING else mirrored(channel)), uncertainty


def mirrored(channel):
    """Return the channel of the same tests, had they gone the other way."""
    ends = channel.operating_range.displacement
    other = SignalRange(2 * START_MM - ends.highest, 2 * START_MM - ends.lowest)
    covered = replace(channel.operating_range, displacement=other)
    return replace(channel, sign=-1, operating_range=covered)


def hitch_of(*modes, **options):
    parts = {mode: identified(mode, **options) for mode in modes}
    channels, uncertainty = ({mode: pair[number] for mode, pair in parts.items()} for number in range(2))
    return Hitch(channels, STEP_S, UNITS, uncertainty=uncertainty)


@pytest.fixture(scope="module")
def model():
    return hitch_of(LIFTING, LOWERING)


@pytest.fixture(scope="module")
def advice(model):
    return design(model)


@settings(max_examples=8)
@given(
    mode=st.sampled_from([LIFTING, LOWERING]),
    highest=st.floats(0.4, 1.5),
    travel=st.floats(1.0, 60.0),
    steps=st.integers(130, 250),
    seed=st.integers(0, 2**16),
)
def test_proposals_stay_within_whatever_limits(model, mode, highest, travel, steps, seed):
    limits = ExcitationLimits(highest, travel, steps * STEP_S)
    values = model.channels[mode].benchmark.named_values()
    # The shortest of many takes half as long as the tests there were, the lowest 0.3 of the highest command.
    if 0.3 * values["gain"] * (highest - ZONE) * LASTING_S / 2 > travel:
        limits = replace(limits, travel=LARGE_MM)
    advised = design(model, mode, limits=limits, seed=seed)
    assert 1 <= len(advised.proposals) <= MAX_PROPOSALS
    for proposal in advised.proposals:
        command = command_of(model, mode, proposal)
        assert (command.size - 1) <= steps
        # A level less the dead zone and more of it again: rounding of numbers of 1.
        assert command.max() <= highest + 4 * np.finfo(float).eps
        effective = np.where(command > 0, command - ZONE, 0.0)
        gone = held(*lagged(*values.values()), effective)
        assert np.abs(gone).max() <= limits.travel * (1 + 1e-9)
        assert np.abs(gone).max() == pytest.approx(proposal.travel, rel=1e-9)


def test_a_limit_between_two_samples_is_kept(model):
    proposals = design(model, LIFTING, limits=ExcitationLimits(longest_s=1.006)).proposals
    assert max(command_of(model, LIFTING, proposal).size - 1 for proposal in proposals) * STEP_S <= 1.006


def test_without_limits_tests_are_like_those_there_were(model, advice):
    covered = model.channels[advice.direction].operating_range
    for proposal in advice.proposals:
        assert 0 <= proposal.low < proposal.high <= float(covered.command.highest)
        # A little beyond what was covered is allowed.
        assert proposal.travel <= 1.02 * float(covered.displacement.highest - covered.displacement.lowest)
        # Whole steps, none beyond.
        lengths = proposal.duration_s / STEP_S / SAMPLES - np.array([0.5, 1.0, 2.0])
        assert np.any((lengths <= 1e-9) & (lengths > -1 / SAMPLES))


def test_proposals_are_sorted_by_what_they_leave_of_the_error(advice):
    left = [proposal.remaining_error[advice.parameter] for proposal in advice.proposals]
    assert left == sorted(left)
    # The best of many is worth more than another of the usual, which leaves √(8/9).
    usual = advice.baseline_reduction[advice.parameter]
    assert left[0] < usual == pytest.approx(np.sqrt(TESTS / (TESTS + 1)))


def test_what_a_test_leaves_follows_from_the_plants_own_derivatives(model):
    advised = design(model, LIFTING, parameter="gain")
    best, information = advised.proposals[0], model.uncertainty[LIFTING].information
    command = command_of(model, LIFTING, best)
    effective = np.where(command > 0, command - ZONE, 0.0)
    values, columns = model.channels[LIFTING].benchmark.named_values(), []
    for name, slope in zip(information.names, information.slopes, strict=True):
        # Central differences of 1e-4: an error of 1e-8, and rounding of 1e-12.
        ahead, behind = (
            held(*lagged(*{**values, name: values[name] * (1 + step)}.values()), effective)
            for step in (1e-4, -1e-4)
        )
        columns.append(slope * (ahead - behind) / (2e-4 * values[name]))
    left = standard_errors_with(information, np.stack(columns, axis=1)) / standard_errors(information)
    assert list(best.remaining_error.values()) == pytest.approx(list(left), rel=1e-6)


def test_by_default_the_parameter_with_the_widest_interval_is_narrowed(model, advice):
    widths = {
        (mode, estimate.name): np.log(estimate.interval[1] / estimate.interval[0])
        for mode, uncertainty in model.uncertainty.items()
        for estimate in uncertainty.benchmark.parameters
    }
    assert len(set(widths.values())) == 4
    assert (advice.direction, advice.parameter) == max(widths, key=widths.get)
    vaguest = max((key for key in widths if key[0] == LIFTING), key=widths.get)
    assert design(model, LIFTING).parameter == vaguest[1]
    vaguest = max((key for key in widths if key[1] == "gain"), key=widths.get)
    assert design(model, parameter="gain").direction == vaguest[0]


def test_advice_depends_on_the_seed_alone(model, advice):
    assert design(model) == advice
    assert design(model, seed=1).proposals != advice.proposals


def test_ramps_are_advised_where_the_dead_zone_is_unknown(model):
    rough = hitch_of(LIFTING, dead_zone=DeadZoneError(0.05, 3))
    # 0.05 A of some 0.3 A are a sixth of the gain, which eight tests with errors of 0.1 mm tell to 1 %.
    assert design(rough, parameter="gain").ramps
    assert not any(design(model, LIFTING, parameter=name).ramps for name in ("gain", "time_constant"))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"parameter": "damping"}, "expected a parameter with a standard error \\(.*gain.*\\), got damping"),
        ({"direction": "sideways"}, r"expected .*lifting gain.*lowering time_constant\), got sideways"),
        ({"direction": LIFTING, "parameter": "damping"}, "got lifting damping"),
        (
            {"direction": LIFTING, "limits": ExcitationLimits(highest=0.3)},
            "highest command: expected more than the dead zone, 0.35, got 0.3",
        ),
        (
            {"direction": LIFTING, "limits": ExcitationLimits(highest=0.35)},
            "expected more than the dead zone, 0.35, got 0.35",
        ),
        (
            {"direction": LIFTING, "limits": ExcitationLimits(travel=0.001)},
            f"lifting: none of {CANDIDATES} candidate tests is within the limits; use wider limits",
        ),
        (
            {"direction": LIFTING, "limits": ExcitationLimits(longest_s=0.03)},  # nothing happens in it
            f"none of {CANDIDATES} candidate tests is within",
        ),
    ],
)
def test_what_cannot_be_designed_is_refused(model, arguments, complaint):
    with pytest.raises(InputError, match=complaint):
        design(model, **arguments)


def test_a_model_that_knows_nothing_of_its_tests_is_refused(model):
    bare = {mode: Uncertainty(uncertainty.benchmark) for mode, uncertainty in model.uncertainty.items()}
    said = r"expected a parameter with a standard error \(nothing\), got anything"
    for ignorant in (made_up(), Hitch(model.channels, STEP_S, UNITS, uncertainty=bare)):
        with pytest.raises(InputError, match=said):
            design(ignorant)


def test_the_dead_zone_is_added_but_not_at_rest(model):
    command = command_of(model, LIFTING, Proposal(0.1, 0.5, 0.2, 2.0, 3, 0.0, {}))
    assert command.size == 201
    assert not command[:5].any()
    assert set(command[5:]) == {0.1 + ZONE, 0.5 + ZONE}
    # Levels are held for whole clocks.
    assert set(np.flatnonzero(np.diff(command[5:])) % 20) == {19}


def read_back(path):
    header, *rows = path.read_text().split()
    return dict(zip(header.split(","), np.array([row.split(",") for row in rows], float).T, strict=True))


def test_a_written_command_reads_back_as_the_best_proposals(model, advice, tmp_path):
    path = tmp_path / "next" / "test.csv"
    write_command(model, advice, path)
    columns = read_back(path)
    command = command_of(model, advice.direction, advice.proposals[0])
    assert list(columns) == ["time_s", "current_up_A", "current_down_A"]
    driven, still = ("current_up_A", "current_down_A")[:: 1 if advice.direction == LIFTING else -1]
    np.testing.assert_allclose(columns[driven], command, rtol=1e-12)
    np.testing.assert_allclose(columns["time_s"], STEP_S * np.arange(command.size), rtol=1e-12)
    assert not columns[still].any()


def test_a_command_that_is_there_is_replaced_by_force_alone(model, advice, tmp_path):
    path = tmp_path / "test.csv"
    path.write_text("mine")
    with pytest.raises(OutputError, match=r"exists.*--force"):
        write_command(model, advice, path)
    assert path.read_text() == "mine"
    write_command(model, advice, path, force=True)
    assert path.read_text().startswith("time_s,")


def test_columns_of_other_units_are_named_after_them(model, advice, tmp_path):
    units = {**UNITS, "lifting_command": "percent", "lowering_command": "percent"}
    write_command(Hitch(model.channels, STEP_S, units), advice, tmp_path / "test.csv")
    columns = ["time_s", "lifting_command_percent", "lowering_command_percent"]
    assert list(read_back(tmp_path / "test.csv")) == columns

"""Two models on tests that neither has seen."""

from dataclasses import replace

import numpy as np
import pytest

from handmade import DEAD_ZONES, GAINS, hitch, hitch_of, with_bands
from handmade import channel as handmade_channel
from hitchid.data.campaign import Campaign
from hitchid.data.record import LIFTING, LOWERING
from hitchid.errors import InputError
from hitchid.model import Provenance
from hitchid.report import comparison_tables
from hitchid.report.comparison_report import verdict_text
from hitchid.validation import compare, validate
from truth import STEP_S, levels

RIGHT, SLOW = hitch(), hitch("first-order-lag")


@pytest.fixture
def campaign(make_record):
    """Return five tests a direction of the plant that `RIGHT` is, with a little noise."""
    records = []
    for mode, sign in ((LIFTING, 1), (LOWERING, -1)):
        for number in range(5):
            rng = np.random.default_rng(number)
            command = levels(rng, 200, low=0.4)
            speed = GAINS[mode] * np.maximum(command - DEAD_ZONES[mode], 0)
            way = STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])
            measured = 100 + sign * way + 0.02 * rng.standard_normal(command.size)
            commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
            records.append(make_record(measured, *commands, name=f"{mode}-{number}"))
    return Campaign.of(records)


def having_seen(model, *records):
    seen = frozenset(record.fingerprint for record in records)
    return replace(model, provenance=Provenance(seen=seen))


def test_the_model_that_errs_less_on_every_test_is_found_on_either_side(campaign):
    for first, second, better in ((RIGHT, SLOW, "A"), (SLOW, RIGHT, "B")):
        compared = compare(first, second, campaign)
        assert compared.sections == (LIFTING, LOWERING)
        for mode in compared.sections:
            verdict = compared.verdict(mode)
            assert (verdict.better, verdict.wins, verdict.tests) == (better, 5, 5)
            assert verdict_text(compared, mode).startswith(
                f"{better} has the smaller free-run error on 5 of 5 tests"
            )
        assert compared.metrics["better"] == {LIFTING: better, LOWERING: better}


def test_a_model_is_never_proven_better_than_itself(campaign):
    compared = compare(RIGHT, RIGHT, campaign)
    for mode in compared.sections:
        assert compared.verdict(mode).better is None
        assert "no significant difference" in verdict_text(compared, mode)


def test_tests_that_either_has_seen_are_left_out_for_both(campaign):
    first, second, *_ = campaign.records
    compared = compare(having_seen(RIGHT, first), having_seen(SLOW, second), campaign)
    assert compared.left_out == 2
    assert "2 tests are left out" in compared.notices[0]
    for accuracy in compared.accuracy(LIFTING):
        assert accuracy.tests == tuple(f"{LIFTING}-{number}" for number in (2, 3, 4))


def test_the_figures_are_those_of_two_validations(campaign):
    compared = compare(RIGHT, SLOW, campaign)
    for model, metrics in ((RIGHT, compared.first.metrics), (SLOW, compared.second.metrics)):
        assert metrics == validate(model, campaign).metrics
    runs = compared.free_runs(LIFTING)
    for name, model in (("a", RIGHT), ("b", SLOW)):
        alone = validate(model, campaign).predictions[LIFTING].models["free_run"]
        for one, other in zip(runs.models[name], alone, strict=True):
            np.testing.assert_array_equal(one, other)


def test_both_models_stand_in_every_table(campaign):
    bands = [with_bands(model, LIFTING) for model in (RIGHT, SLOW)]
    for table in comparison_tables(compare(*bands, campaign)).tables:
        cells = {row[0] for row in table.rows} | set(table.header)
        assert {"model A", "model B"} <= cells


def test_models_without_a_direction_in_common_cannot_be_compared(campaign):
    lifting, lowering = (hitch_of(handmade_channel(mode)) for mode in (LIFTING, LOWERING))
    with pytest.raises(InputError, match=r"A .*lifting, .*B .*lowering"):
        compare(lifting, lowering, campaign)


def test_models_of_two_clocks_cannot_be_compared(campaign):
    with pytest.raises(InputError, match=r"0\.01 s, model B .*0\.02 s"):
        compare(RIGHT, replace(RIGHT, step_s=0.02), campaign)


def test_what_is_said_of_one_model_alone_is_said_with_its_name(campaign):
    lifting = hitch_of(handmade_channel(LIFTING))
    compared = compare(RIGHT, lifting, campaign)
    assert any(each.startswith("model B: ") and "no lowering channel" in each for each in compared.notices)
    assert not any(
        each.startswith("model A: ") and "no lowering channel" in each for each in compared.notices
    )


def test_where_every_test_was_used_there_is_nothing_to_compare(campaign):
    with pytest.raises(InputError, match="every test was used to identify"):
        compare(having_seen(RIGHT, *campaign.records), SLOW, campaign)


def test_cycles_are_cut_alike_for_both_where_there_is_nothing_else(make_record):
    rng = np.random.default_rng(3)
    up, down = (np.concatenate([np.zeros(70), levels(rng, 330, low=0.5)]) for _ in range(2))
    records = []
    for number in range(3):
        lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
        speed = GAINS[LIFTING] * np.maximum(lifting - DEAD_ZONES[LIFTING], 0)
        speed -= GAINS[LOWERING] * np.maximum(lowering - DEAD_ZONES[LOWERING], 0)
        measured = 100 + STEP_S * np.cumsum(speed) + 0.02 * rng.standard_normal(speed.size)
        records.append(make_record(measured, lifting, lowering, name=f"cycle-{number}"))
    cut = replace(RIGHT, provenance=Provenance(segmentation_dead_zones={LIFTING: 0.3, LOWERING: 0.2}))
    compared = compare(
        cut, replace(SLOW, provenance=Provenance(segmentation_dead_zones=DEAD_ZONES)), Campaign.of(records)
    )
    assert "cycles" in compared.sections
    for part in compared.sections:
        one, other = compared.accuracy(part)
        assert one.tests == other.tests

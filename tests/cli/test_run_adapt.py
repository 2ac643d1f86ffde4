"""`hitchid run --adapt`: what it learns is written to a change log, gone on from, and saved at the end."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from commands import hitchid

import machine
from hitchid.live import Changes, Event, changed_model, read_events
from hitchid.live.events import LEARNED, MOVED, PROMOTED
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import load, save
from machine import STEP_S

STROKES = machine.strokes(8, seed=7, scatter=0.015, changed_at=2, samples=60, gain=1.15)
SAMPLES = len(STROKES[0].displacement)
EARLIER = Changes(0.05, 0.01, 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a model as identified."""
    path = tmp_path_factory.mktemp("adapted") / "model"
    save(machine.MODEL, path)
    return path


def lines(strokes):
    """Return the samples of strokes as lines of JSON."""
    commands, displacement = machine.stream(strokes)
    return "".join(
        json.dumps(
            {"time_s": number * STEP_S, "lifting_command": up, "lowering_command": down, "displacement": y}
        )
        + "\n"
        for number, (up, down, y) in enumerate(zip(*commands.T.tolist(), displacement.tolist(), strict=True))
    )


def run(*arguments, stdin=""):
    """Return exit code, answers and what the program says on standard error."""
    result = hitchid("run", *arguments, stdin=stdin)
    return result.code, [json.loads(line) for line in result.out.splitlines()], result.err


def test_it_learns_writes_what_and_saves_the_model(folder, tmp_path):
    changes, saved = tmp_path / "changes.jsonl", tmp_path / "saved"
    code, answers, said = run(folder, "--adapt", "--changes", changes, "--save", saved, stdin=lines(STROKES))
    assert code == 0
    assert len(answers) == len(STROKES) * SAMPLES
    events = read_events(changes)
    assert [event.stroke for event in events if event.kind == LEARNED] == [*range(1, len(STROKES) + 1)]
    promoted = [event for event in events if event.kind == PROMOTED]
    assert promoted
    flags = [flag for answer in answers for flag in answer["flags"]]
    assert all(flags.count(event.sentence) == 1 for event in promoted)
    assert not any("moved" in flag or "learned" in flag for flag in flags)
    moved = {event.direction: event.changes for event in events if event.kind == MOVED}
    first, summary, *directions = said.splitlines()
    assert (first, summary) == ("ready", f"adaptation: {len(STROKES)} strokes learned from, 0 refused")
    assert [line.split(":")[0] for line in directions] == [LIFTING, LOWERING]
    for line, direction in zip(directions, (LIFTING, LOWERING), strict=True):
        gain = 100 * np.expm1(moved[direction].gain) if direction in moved else 0.0
        promotions = sum(event.direction == direction for event in promoted)
        assert (f"gain {gain:+.3g} %, dead zone " in line) == (direction in moved)
        assert line.endswith(f"; {promotions} promoted" if promotions else ": as identified")
    expected, again = changed_model(machine.MODEL, moved), load(saved)
    assert again.provenance.adapted == expected.provenance.adapted != {}
    for mode, channel in expected.channels.items():
        assert again.channels[mode].dead_zone == channel.dead_zone
        np.testing.assert_array_equal(again.channels[mode].benchmark.values, channel.benchmark.values)


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="signals are others there")
@pytest.mark.parametrize("reads", [True, False])
def test_ctrl_c_ends_the_input_with_or_without_reader(folder, tmp_path, reads):
    command = [sys.executable, "-m", "hitchid", "run", folder, "--adapt", "--save", tmp_path / "saved"]
    pipe = subprocess.PIPE
    with subprocess.Popen(  # noqa: S603 - this Python, the command under test
        command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True
    ) as child:
        child.stdin.write(lines(STROKES[:2]))
        child.stdin.flush()
        for _ in range(2 * SAMPLES):
            child.stdout.readline()
        if not reads:
            child.stdout.close()
            child.stdin.write("{}")  # the beginning of a line: answered at the end of the input
            child.stdin.flush()
        os.killpg(child.pid, signal.SIGINT)  # as a terminal does
        said = child.stderr.read()
        child.wait()
    assert said.splitlines()[1] == "adaptation: 2 strokes learned from, 0 refused"
    assert (tmp_path / "saved").is_dir()
    if reads:
        assert child.returncode == 0


def test_it_goes_on_from_a_change_log(folder, tmp_path):
    changes, saved = tmp_path / "changes.jsonl", tmp_path / "saved"
    earlier = [
        Event(PROMOTED, 10.0, 4, LOWERING, "better", EARLIER),
        Event(MOVED, 10.0, 4, LOWERING, "towards the promoted values", EARLIER),
    ]
    text = "".join(event.to_json() + "\n" for event in earlier)
    # The program was stopped while it wrote the last line.
    changes.write_text(text + text[: len(text) // 4])
    code, answers, _ = run(folder, "--adapt", "--changes", changes, "--save", saved, stdin=lines(STROKES[:2]))
    assert code == 0
    assert changes.read_text().startswith(text)
    learned = [event for event in read_events(changes)[2:] if event.kind == LEARNED]
    assert [event.stroke for event in learned] == [5, 6]
    # The time of the log goes on, at the end of its last entry.
    ends_s = [10.0 + STEP_S * (number * SAMPLES) for number in (1, 2)]
    assert [event.time_s for event in learned] == pytest.approx(ends_s)
    assert load(saved).provenance.adapted[LOWERING]["gain"] == EARLIER.gain
    # From the first sample on the model is that of the log.
    model = changed_model(machine.MODEL, {LOWERING: EARLIER})
    last = SAMPLES + 80
    commands, displacement = machine.stream(STROKES[:2])
    state = model.init_state(float(displacement[0]))
    for command, measured in zip(commands[:last], displacement[:last], strict=True):
        state, predicted = model.step(state, command, measured)
    assert answers[last - 1]["displacement"] == pytest.approx(float(predicted), rel=1e-12)


@pytest.mark.parametrize("option", ["--changes", "--save"])
def test_what_is_for_adaptation_is_refused_without_it(folder, tmp_path, option):
    code, answers, said = run(folder, option, tmp_path / "file")
    assert (code, answers) == (2, [])
    assert said == "hitchid: --changes and --save are for adaptation; give --adapt, too\n"
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_already_is_left_alone(folder, tmp_path):
    (tmp_path / "saved").mkdir()
    file, notes = tmp_path / "saved" / "mine.txt", tmp_path / "notes.txt"
    file.write_text("mine")
    notes.write_text("mine\n")
    for options, said in (
        (("--save", tmp_path / "saved"), "saved"),
        (("--changes", notes), "line 1: is no entry of a change log"),
    ):
        code, answers, message = run(folder, "--adapt", *options, stdin=lines(STROKES[:1]))
        assert (code, answers) == (2, [])
        assert said in message
    assert (file.read_text(), notes.read_text()) == ("mine", "mine\n")


def test_a_change_log_that_cannot_be_written_is_told(folder, tmp_path):
    (tmp_path / "file").write_text("mine")
    code, _, said = run(folder, "--adapt", "--changes", tmp_path / "file" / "changes.jsonl")
    assert code != 0
    assert "changes.jsonl: cannot be written: File exists" in said


def test_an_adapted_model_is_refused(tmp_path):
    save(changed_model(machine.MODEL, {LIFTING: EARLIER}), tmp_path / "model")
    changes = tmp_path / "new" / "changes.jsonl"
    code, answers, said = run(tmp_path / "model", "--adapt", "--changes", changes)
    assert (code, answers) == (2, [])
    assert "expected one as identified, got one that was adapted" in said
    assert not changes.parent.exists()


def test_the_change_log_of_another_model_is_refused(folder, tmp_path):
    changes = tmp_path / "changes.jsonl"
    changes.write_text(json.dumps({"model": "0" * 64}) + "\n")
    code, answers, said = run(folder, "--adapt", "--changes", changes)
    assert (code, answers) == (2, [])
    assert f"another model: got digest 000000000000, expected {load(folder).provenance.digest[:12]}" in said

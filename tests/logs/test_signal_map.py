"""`campaign.toml`: what it says, what it refuses, and how it is told."""

import pytest

from hitchid.errors import SettingsError
from hitchid.logs.signal_map import DEFAULT_SIGNALS, SignalColumn, read_campaign_file

CONTRACT = """
[signals]
time = "time_s"
lifting_command = { column = "duty_up_percent", unit = "percent" }
lowering_command = { column = "duty_down_percent", unit = "percent" }
displacement = { column = "angle_deg", unit = "deg" }
covariates = ["head_pressure"]

[split]
test = ["*-050-*", "*-090-*"]

[tests]
"warm-up-*" = "cycle"
"""


def parse(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_campaign_file(path)


def test_the_file_of_the_contract_is_understood(tmp_path):
    file = parse(tmp_path, CONTRACT)
    assert file.signals.time == SignalColumn(column="time_s", unit="s")
    assert file.signals.lifting_command == SignalColumn(column="duty_up_percent", unit="percent")
    assert file.signals.lowering_command == SignalColumn(column="duty_down_percent", unit="percent")
    assert file.signals.displacement == SignalColumn(column="angle_deg", unit="deg")
    assert file.signals.covariates == (SignalColumn.model_validate({"column": "head_pressure"}),)
    assert file.split is not None
    assert file.split.test == ("*-050-*", "*-090-*")
    assert file.tests == {"warm-up-*": "cycle"}


def test_an_empty_file_means_the_default_columns(tmp_path):
    file = parse(tmp_path, "")
    assert file.signals == DEFAULT_SIGNALS
    assert (file.split, file.tests) == (None, {})
    used = (file.signals.time, file.signals.lifting_command, file.signals.lowering_command)
    assert [column.column for column in used if column] == ["time_s", "current_up_A", "current_down_A"]
    assert file.signals.displacement.column == "displacement_mm"


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path):
    text = b"\xef\xbb\xbf" + CONTRACT.replace("\n", "\r\n").encode()
    assert parse(tmp_path, text) == parse(tmp_path, CONTRACT)


@pytest.mark.parametrize("command", ["command", "lifting_command", "lowering_command"])
def test_one_command_is_enough(tmp_path, command):
    signals = parse(tmp_path, f'[signals]\n{command} = "valve_V"').signals
    assert getattr(signals, command) == SignalColumn(column="valve_V", unit="V")


SIGNED = '[signals]\ncommand = "valve_V"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[signal]\ncommand = "valve_V"', ["'signal'", "not known"]),
        (SIGNED + 'displacment = "x_mm"', ["'signals.displacment'", "not known"]),
        (SIGNED + 'time = { column = "t", unit = "s", sclae = 2 }', ["'signals.time.sclae'", "not known"]),
        (
            SIGNED + 'displacement = { column = "x", unit = "furlong" }',
            ["displacement.unit", "'furlong'", "mm"],
        ),
        (SIGNED + 'displacement = { column = "x", unit = 3 }', ["displacement.unit", "got 3"]),
        (SIGNED + 'time = { column = "t", unit = "mm" }', ["time", "'mm'", "length", "time"]),
        (SIGNED + 'displacement = "head_bar"', ["displacement", "'bar'", "pressure"]),
        (SIGNED + 'lifting_command = "up_A"', ["signals", "command", "not both"]),
        ('[signals]\ndisplacement = "x_mm"', ["signals", "at least one of command"]),
        ("signals = 3", ["'signals'", "got 3"]),
        ('[split]\ntest = "x"', ["'split.test'", "got 'x'"]),
        ("[split]\ntest = []", ["'split.test'", "at least 1"]),
        ("[split]", ["'split.test'", "expected a value"]),
        ('[tests]\nx = "liftng"', ["'tests.x'", "'lifting'", "got 'liftng'"]),
        ("[signals]\ntime =\n", ["not valid TOML", "line 2"]),
        ('x = "a"\nx = "b"', ["not valid TOML"]),
        (b"\xff\xfe", ["cannot be read", "0xff"]),
    ],
)
def test_what_is_not_understood_is_named_with_file_and_key(tmp_path, text, words):
    with pytest.raises(SettingsError, match=f"^{tmp_path / 'campaign.toml'}: .*$") as caught:
        parse(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words)


def test_a_file_that_is_not_there_is_named(tmp_path):
    for path in (tmp_path / "nope.toml", tmp_path):
        with pytest.raises(SettingsError, match="cannot be read") as caught:
            read_campaign_file(path)
        assert str(path) in str(caught.value)


def test_columns_and_covariates_may_have_zero_and_scale(tmp_path):
    signals = parse(
        tmp_path,
        """
        [signals]
        command = { column = "Boom Cmd", unit = "l/min", zero = 7.4745, scale = -1 }
        covariates = ["oil", { column = "T", unit = "degC", zero = 273.15, scale = 1 }]
        """,
    ).signals
    assert signals.command == SignalColumn(column="Boom Cmd", unit="l/min", zero=7.4745, scale=-1.0)
    assert [(column.column, column.unit) for column in signals.covariates][1:] == [("T", "degC")]
    assert signals.covariates[0].column == "oil"


@pytest.mark.parametrize("given", ["scale = 0", "scale = nan", "scale = inf", "zero = nan", 'zero = "x"'])
def test_zero_and_scale_are_numbers_with_an_inverse(tmp_path, given):
    key = given.split(" ")[0]
    with pytest.raises(SettingsError, match=rf"key 'signals\.command\.{key}'"):
        parse(tmp_path, f'[signals]\ncommand = {{ column = "u", unit = "V", {given} }}')

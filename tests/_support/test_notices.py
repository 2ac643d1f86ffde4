from hitchid._support.records import Notice, Severity


def test_a_notice_is_printed_as_place_and_sentence():
    notice = Notice("clock-resampled", "the clock jitters")
    assert str(notice) == "the clock jitters"
    assert str(notice.at("log-1")) == "log-1: the clock jitters"
    assert str(notice.at("@2").at("log-1")) == "log-1: @2: the clock jitters"


def test_a_notice_is_a_note_unless_said_otherwise():
    assert Notice("code", "sentence").severity is Severity.NOTE
    assert Notice("code", "sentence", "here", Severity.FAULT).at("there").severity is Severity.FAULT

"""Signals are taken note of once, and obeyed the second time."""

import signal

import pytest

from maniskill_grpd.runs.stop_request import SIGNALS, stop_request


@pytest.fixture(autouse=True)
def _not_ignored():
    """Tests in the background of a shell inherit that Ctrl-C is ignored."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_a_request_and_handlers_are_as_before_afterwards(number, capsys):
    before = [signal.getsignal(other) for other in SIGNALS]
    with stop_request() as request:
        assert not request()
        signal.raise_signal(number)
        assert request()
        assert request.exit_code == 128 + number
    assert capsys.readouterr().err == f"{number.name}: stops after this iteration; a second one stops at once\n"
    assert [signal.getsignal(other) for other in SIGNALS] == before


def test_ctrl_c_a_second_time_interrupts():
    with stop_request():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_launcher_that_terminates_after_ctrl_c_asks_for_the_same(capsys):
    """A study passes a Ctrl-C on, which its trainings have got from the terminal already."""
    with stop_request() as request:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert request.received == signal.SIGINT
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_what_is_ignored_stays_ignored():
    """`nohup maniskill-grpd train` goes on when the terminal is closed."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stop_request() as request:
        signal.raise_signal(signal.SIGHUP)
        assert not request()
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN

"""What ends a program, and what is finished before it does."""

from __future__ import annotations

import os
import signal

import pytest

from resync_robot.signals import ENDING, EndedBySignal, held, let_through, number_of, raised, words_for


def tell(number: int) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", ENDING)
def test_each_is_a_keyboard_interrupt_that_knows_its_signal(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt) as caught, raised():
        tell(number)
    assert number_of(caught.value) == number and str(caught.value) == words_for(number)
    assert signal.getsignal(number) is before


def test_a_plain_control_c_is_one_too() -> None:
    assert number_of(KeyboardInterrupt()) == signal.SIGINT


def test_what_the_process_was_told_to_ignore_stays_ignored() -> None:
    """As `nohup` does."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with raised():
            tell(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def test_held_it_waits_for_the_end_of_the_outermost_block() -> None:
    done = []
    with pytest.raises(EndedBySignal) as caught, raised(), held():
        with held():
            tell(signal.SIGTERM)
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"] and caught.value.number == signal.SIGTERM
    # It is told once.
    with raised(), held():
        pass


def test_held_it_does_not_hide_another_error() -> None:
    with pytest.raises(ZeroDivisionError), raised(), held():
        tell(signal.SIGTERM)
        raise ZeroDivisionError
    with raised(), held():
        pass


def test_let_through_it_raises_at_once_and_what_comes_after_waits_again() -> None:
    done = []
    with pytest.raises(EndedBySignal) as caught, raised(), held():
        try:
            with let_through():
                tell(signal.SIGHUP)
                done.append("not reached")
        except EndedBySignal as end:
            done.append(str(end))
        tell(signal.SIGTERM)
        done.append("finished")
    assert done == ["ended by SIGHUP", "finished"] and caught.value.number == signal.SIGTERM


def test_one_that_has_waited_is_let_through_first() -> None:
    with pytest.raises(EndedBySignal), raised(), held():
        tell(signal.SIGTERM)
        with let_through():
            pytest.fail("begun though the program was told to end")

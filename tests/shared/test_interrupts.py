"""Signals that end a process come when they can do no harm."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from nufleet.shared.interrupts import Interrupts, postponed


class FailureError(Exception):
    """What ended a block, other than a signal."""


def interrupted(*, fails: bool) -> Iterator[str]:
    """Say how far a block comes that postpones interrupts and is interrupted at its beginning."""
    with postponed():
        signal.raise_signal(signal.SIGINT)
        yield "the rest of the block"
        if fails:
            raise FailureError
    yield "what follows the block"


@pytest.mark.parametrize("fails", [False, True])
def test_an_interrupt_that_is_postponed_comes_when_the_block_ends(fails: bool) -> None:
    block = interrupted(fails=fails)
    assert next(block) == "the rest of the block"
    with pytest.raises(KeyboardInterrupt) as found:
        next(block)
    assert isinstance(found.value.__context__, FailureError) == fails


def test_nothing_is_raised_when_nothing_was_postponed_and_the_handlers_are_those_before() -> None:
    before = signal.getsignal(signal.SIGINT)
    with postponed():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_a_signal_that_the_process_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with postponed():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


def interrupted_twice() -> None:
    with Interrupts("the robots land"):
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            signal.raise_signal(signal.SIGTERM)


def test_a_second_interrupt_is_announced_only(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted_twice()
    assert capfd.readouterr().err == "the robots land\n"

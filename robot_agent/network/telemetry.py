"""Batches a running motion's samples, so that many robots can be watched at once."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import TransportError
from nufleet.shared.wire.codec import Message, encode
from nufleet.shared.wire.transport import Publisher

PERIOD_S = 0.1

_log = logging.getLogger(__name__)


class TelemetryBatcher:
    """Collects samples and publishes them at most every `PERIOD_S`; used from one thread."""

    def __init__(
        self,
        publisher: Publisher,
        make: Callable[[int, tuple[FloatArray, ...]], Message],
        *,
        clock: Callable[[], float],
    ) -> None:
        """Begin with nothing.

        Args:
            publisher: where the batches go.
            make: makes the message from the index of the batch's first sample and its signals.
            clock: monotonic, in s.
        """
        self._publisher = publisher
        self._make = make
        self._clock = clock
        self._last_s = clock()
        self._first = 0
        self._parts: list[tuple[FloatArray, ...]] = []

    def add(self, first: int, *signals: FloatArray) -> None:
        """Take samples that follow the ones before; publish when it is time.

        Every signal has one row per sample, `first` is the index of the first one.
        """
        if not self._parts:
            self._first = first
        self._parts.append(signals)
        if self._clock() - self._last_s >= PERIOD_S:
            self.flush()

    def flush(self) -> None:
        """Publish what has been collected; a motion goes on whether or not anybody can hear it."""
        self._last_s = self._clock()
        if not self._parts:
            return
        signals = tuple(np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        self._parts.clear()
        try:
            self._publisher.put(encode(self._make(self._first, signals)))
        except TransportError as error:
            _log.warning("samples from %d on were lost: %s", self._first, error)

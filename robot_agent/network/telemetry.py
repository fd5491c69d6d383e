"""Publishes a running motion's samples in batches, so that many robots can be watched at once."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import TransportError
from nufleet.shared.wire.codec import Message, encode
from nufleet.shared.wire.requests import Publisher

PERIOD_S = 0.1
"""Shortest interval between two batches."""

_log = logging.getLogger(__name__)


class TelemetryBatcher:
    """Collects samples and publishes them at most every `PERIOD_S`; used from one thread.

    `heard` says whether a program listened when a batch was due last; before any was, it is true.
    """

    def __init__(
        self,
        publisher: Publisher,
        make: Callable[[int, tuple[FloatArray, ...]], Message],
        *,
        clock: Callable[[], float],
    ) -> None:
        """Begin with an empty batch.

        Args:
            publisher: Publisher of the batches.
            make: Function that makes the message from the index of the batch's first sample and its
                signals, each with one row per sample.
            clock: Function that returns monotonic time in seconds.
        """
        self._publisher = publisher
        self._make = make
        self._clock = clock
        self._last_s = clock()
        self._first = 0
        self._parts: list[tuple[FloatArray, ...]] = []
        self.heard = True

    def add(self, first: int, *signals: FloatArray) -> None:
        """Add samples that follow the previous ones, and publish the batch when it is due.

        Args:
            first: Index of the first sample added.
            signals: Signals in the order that `make` expects, each with one row per sample.
        """
        if not self._parts:
            self._first = first
        self._parts.append(signals)
        if self._clock() - self._last_s >= PERIOD_S:
            self.flush()

    def flush(self) -> None:
        """Publish the samples collected if anybody listens.

        A failure is only logged, and the motion continues.
        """
        self._last_s = self._clock()
        parts, self._parts = self._parts, []
        try:
            self.heard = self._publisher.heard
            if parts and self.heard:
                signals = tuple(np.concatenate(signal) for signal in zip(*parts, strict=True))
                self._publisher.put(encode(self._make(self._first, signals)))
        except TransportError as error:
            _log.warning("samples from %d on were lost: %s", self._first, error)

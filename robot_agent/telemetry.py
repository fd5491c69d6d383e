"""Batches a running motion's samples, so that many robots can be watched at once."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from shared.arrays import FloatArray
from shared.codec import encode
from shared.errors import TransportError
from shared.messages import Telemetry
from shared.transport import Publisher

PERIOD_S = 0.1

_log = logging.getLogger(__name__)


class TelemetryBatcher:
    """Collects samples and publishes them at most every `PERIOD_S`; used from one thread."""

    def __init__(
        self,
        publisher: Publisher,
        goal_id: str,
        sample_time_s: float,
        *,
        clock: Callable[[], float],
    ) -> None:
        self._publisher = publisher
        self._goal_id = goal_id
        self._sample_time_s = sample_time_s
        self._clock = clock
        self._last_s = clock()
        self._first = 0
        self._reference: list[FloatArray] = []
        self._response: list[FloatArray] = []

    def add(self, first: int, reference: FloatArray, response: FloatArray) -> None:
        """Take samples that follow the ones before; publish when it is time."""
        if not self._reference:
            self._first = first
        self._reference.append(reference)
        self._response.append(response)
        if self._clock() - self._last_s >= PERIOD_S:
            self.flush()

    def flush(self) -> None:
        """Publish what has been collected; a motion goes on whether or not anybody can hear it."""
        self._last_s = self._clock()
        if not self._reference:
            return
        batch = Telemetry(
            goal_id=self._goal_id,
            first_sample=self._first,
            sample_time_s=self._sample_time_s,
            reference=np.concatenate(self._reference),
            response=np.concatenate(self._response),
        )
        self._reference.clear()
        self._response.clear()
        try:
            self._publisher.put(encode(batch))
        except TransportError as error:
            _log.warning(
                "samples of %s from %d on were lost: %s", self._goal_id, self._first, error
            )

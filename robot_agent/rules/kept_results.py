"""The results of ended goals, kept until they are acknowledged, within bounds."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable

from nufleet.shared.wire.messages import GoalResult

KEPT_RESULTS = 32
"""Largest number of unacknowledged results that are kept; the oldest are dropped first."""

KEPT_RESULT_BYTES = 256 * 2**20
"""Largest total size of their samples in bytes; the newest result is always kept."""


class KeptResults:
    """The results of ended goals, by goal id, oldest first."""

    def __init__(self) -> None:
        self._results: OrderedDict[str, GoalResult] = OrderedDict()
        self._bytes = 0

    def add(self, result: GoalResult) -> None:
        """Keep a result, and drop the oldest ones while there are too many."""
        self._results[result.goal_id] = result
        self._bytes += _size_bytes(result)
        while len(self._results) > 1 and (
            len(self._results) > KEPT_RESULTS or self._bytes > KEPT_RESULT_BYTES
        ):
            self.forget([next(iter(self._results))])

    def get(self, goal_id: str) -> GoalResult | None:
        """Return a goal's result; None when it is not kept."""
        return self._results.get(goal_id)

    def forget(self, goal_ids: Iterable[str]) -> None:
        """Drop the results of these goals; unknown ids are ignored."""
        for goal_id in goal_ids:
            result = self._results.pop(goal_id, None)
            if result is not None:
                self._bytes -= _size_bytes(result)


def _size_bytes(result: GoalResult) -> int:
    return result.reference.nbytes + result.response.nbytes

"""The results of ended goals, kept until they are acknowledged, within bounds."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable

from nufleet.shared.wire.messages import GoalResult

KEPT_RESULTS = 32
"""Results that nobody acknowledged are kept up to this number; the oldest go first."""

KEPT_RESULT_BYTES = 256 * 2**20
"""And up to this many bytes of samples; the newest is kept whatever its size."""


class KeptResults:
    """Results by goal id, oldest first."""

    def __init__(self) -> None:
        self._results: OrderedDict[str, GoalResult] = OrderedDict()
        self._bytes = 0

    def add(self, result: GoalResult) -> None:
        """Keep a result, and let the oldest go where there are too many."""
        self._results[result.goal_id] = result
        self._bytes += _size_bytes(result)
        while len(self._results) > 1 and (
            len(self._results) > KEPT_RESULTS or self._bytes > KEPT_RESULT_BYTES
        ):
            self.forget([next(iter(self._results))])

    def get(self, goal_id: str) -> GoalResult | None:
        """Return a result that is kept still."""
        return self._results.get(goal_id)

    def forget(self, goal_ids: Iterable[str]) -> None:
        """Let results go; ids that are not known do no harm."""
        for goal_id in goal_ids:
            result = self._results.pop(goal_id, None)
            if result is not None:
                self._bytes -= _size_bytes(result)


def _size_bytes(result: GoalResult) -> int:
    return result.reference.nbytes + result.response.nbytes

"""A measured figure with what was aimed at, as a line of a table and as JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Figure:
    """`limit` is what `value` has to stay at or below; None where nothing was promised."""

    name: str
    value: float
    unit: str
    limit: float | None = None
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def holds(self) -> bool | None:
        """Whether the promise is kept; None where there is none."""
        return None if self.limit is None else self.value <= self.limit

    def document(self) -> dict[str, Any]:
        """Return what JSON says of it."""
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "limit": self.limit,
            "holds": self.holds,
            **self.details,
        }

    def __str__(self) -> str:
        promise = "" if self.limit is None else f"  (at most {self.limit:g}"
        promise += {None: "", True: ", holds)", False: ", MISSED)"}[self.holds]
        more = ", ".join(f"{key} {value}" for key, value in self.details.items())
        return f"{self.name:58} {self.value:10.4g} {self.unit:10}{promise}  {more}"

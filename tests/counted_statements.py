"""The statements that a repository sends to its database."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event

from nufleet.orchestrator.repository.repository import Repository


@contextmanager
def counted_statements(repository: Repository) -> Iterator[list[str]]:
    """Yield a list that receives the first words of each statement, one entry for many rows."""
    said: list[str] = []

    def heard(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        said.append(" ".join(statement.split()[:2]))

    engine = repository._database._engine
    event.listen(engine, "before_cursor_execute", heard)
    try:
        yield said
    finally:
        event.remove(engine, "before_cursor_execute", heard)

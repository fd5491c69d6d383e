"""Responses say which part of their variances is due to a transient that the tones may hide."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Add it; of responses stored before it is not known."""
    for table in ("responses", "flight_responses"):
        op.add_column(table, sa.Column("hidden_variance", sa.LargeBinary(), nullable=True))
    op.add_column("matrices", sa.Column("all_hidden_variances", sa.LargeBinary(), nullable=True))

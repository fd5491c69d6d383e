"""Responses say how many degrees of freedom their variances have, and the amplitude played."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Add both; of responses stored before they are not known."""
    op.add_column("responses", sa.Column("degrees", sa.LargeBinary(), nullable=True))
    op.add_column("responses", sa.Column("amplitude", sa.Double(), nullable=True))

"""Trials say whether their orchestrator ended them, studies what came out, responses what kind."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add all three; of what was stored before they are not known."""
    op.add_column("trials", sa.Column("interrupted", sa.Boolean(), nullable=True))
    op.add_column("studies", sa.Column("result", sa.Text(), nullable=True))
    op.add_column("responses", sa.Column("kind", sa.Text(), nullable=True))

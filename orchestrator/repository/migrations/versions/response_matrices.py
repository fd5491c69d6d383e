"""Every entry of the response that a test of several axes measured."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add their table."""
    op.create_table(
        "matrices",
        sa.Column("goal_id", sa.Text(), nullable=False),
        sa.Column("axes", sa.Text(), nullable=False),
        sa.Column("all_omega_rad_s", sa.LargeBinary(), nullable=False),
        sa.Column("all_z", sa.LargeBinary(), nullable=False),
        sa.Column("all_variances", sa.LargeBinary(), nullable=False),
        sa.Column("all_degrees", sa.LargeBinary(), nullable=False),
        sa.Column("correlation", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["goal_id"], ["responses.goal_id"], name=op.f("fk_matrices_goal_id")
        ),
        sa.PrimaryKeyConstraint("goal_id", name=op.f("pk_matrices")),
    )

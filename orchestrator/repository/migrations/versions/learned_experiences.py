"""Experiences belong to a fleet, and say which run they were learned in and when."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table again: no nufleet that knew the former one stored anything in it."""
    op.drop_table("experiences")
    op.create_table(
        "experiences",
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("architecture", sa.Text(), nullable=False),
        sa.Column("manifest", sa.Text(), nullable=False),
        sa.Column("run", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.Column("learned_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["fleet", "robot"],
            ["robots.fleet", "robots.robot"],
            name=op.f("fk_experiences_fleet_robot"),
        ),
        sa.PrimaryKeyConstraint("fleet", "sha256", name=op.f("pk_experiences")),
    )
    op.create_index(
        op.f("ix_experiences_fleet_experiences_robot"),
        "experiences",
        ["fleet", "robot"],
        unique=False,
    )

"""Responses that no test measured: of flights along paths, and of logs of other programs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add their table."""
    op.create_table(
        "flight_responses",
        sa.Column("goal_id", sa.Text(), nullable=False),
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("axis", sa.Text(), nullable=False),
        sa.Column("origin", sa.Text(), nullable=False),
        sa.Column("came_from", sa.Text(), nullable=False),
        sa.Column("circumstances", sa.Text(), nullable=False),
        sa.Column("tones", sa.Integer(), nullable=False),
        sa.Column("omega_rad_s", sa.LargeBinary(), nullable=False),
        sa.Column("z", sa.LargeBinary(), nullable=False),
        sa.Column("variance", sa.LargeBinary(), nullable=False),
        sa.Column("segments", sa.Integer(), nullable=False),
        sa.Column("quality", sa.Text(), nullable=False),
        sa.Column("usable", sa.Boolean(), nullable=False),
        sa.Column("measured_at", sa.DateTime(), nullable=False),
        sa.Column("degrees", sa.LargeBinary(), nullable=True),
        sa.Column("amplitude", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["fleet", "robot"],
            ["robots.fleet", "robots.robot"],
            name=op.f("fk_flight_responses_fleet_robot"),
        ),
        sa.PrimaryKeyConstraint("goal_id", name=op.f("pk_flight_responses")),
    )
    op.create_index(
        op.f("ix_flight_responses_fleet_flight_responses_robot_flight_responses_axis"),
        "flight_responses",
        ["fleet", "robot", "axis"],
    )

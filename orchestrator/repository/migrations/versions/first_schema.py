"""The first schema: robots, studies, trials, responses with their samples, experiences, leases."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "leases",
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("owner", sa.Text(), nullable=True),
        sa.Column("epoch", sa.BigInteger(), nullable=False),
        sa.Column("term_s", sa.Double(), nullable=False),
        sa.Column("expires_s", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("fleet", "robot", name=op.f("pk_leases")),
    )
    op.create_table(
        "robots",
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("spec", sa.Text(), nullable=False),
        sa.Column("boot_id", sa.Text(), nullable=False),
        sa.Column("described_at", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("fleet", "robot", name=op.f("pk_robots")),
    )
    op.create_table(
        "studies",
        sa.Column("study_id", sa.Text(), nullable=False),
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("algorithm", sa.Text(), nullable=False),
        sa.Column("plan", sa.Text(), nullable=False),
        sa.Column("seed", sa.Text(), nullable=False),
        sa.Column("parameters", sa.Text(), nullable=False),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("begun_at", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("study_id", name=op.f("pk_studies")),
    )
    op.create_table(
        "experiences",
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("manifest", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.Column("stored_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["fleet", "robot"],
            ["robots.fleet", "robots.robot"],
            name=op.f("fk_experiences_fleet_robot"),
        ),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_experiences")),
    )
    op.create_index(
        op.f("ix_experiences_fleet_experiences_robot"),
        "experiences",
        ["fleet", "robot"],
        unique=False,
    )
    op.create_table(
        "trials",
        sa.Column("goal_id", sa.Text(), nullable=False),
        sa.Column("study_id", sa.Text(), nullable=False),
        sa.Column("iteration", sa.Integer(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("excitation", sa.Text(), nullable=False),
        sa.Column("epoch", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.Text(), nullable=False),
        sa.Column("boot_id", sa.Text(), nullable=True),
        sa.Column("plan", sa.Text(), nullable=True),
        sa.Column("outcome", sa.Text(), nullable=True),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("retry", sa.Text(), nullable=True),
        sa.Column("robot_time_s", sa.Double(), nullable=False),
        sa.Column("intended_at", sa.DateTime(), nullable=False),
        sa.Column("ended_at", sa.DateTime(), nullable=True),
        sa.ForeignKeyConstraint(
            ["study_id"], ["studies.study_id"], name=op.f("fk_trials_study_id")
        ),
        sa.PrimaryKeyConstraint("goal_id", name=op.f("pk_trials")),
        sa.UniqueConstraint(
            "study_id",
            "iteration",
            "robot",
            "attempt",
            name=op.f("uq_trials_study_id_iteration_robot_attempt"),
        ),
    )
    op.create_table(
        "responses",
        sa.Column("goal_id", sa.Text(), nullable=False),
        sa.Column("fleet", sa.Text(), nullable=False),
        sa.Column("robot", sa.Text(), nullable=False),
        sa.Column("axis", sa.Text(), nullable=False),
        sa.Column("tones", sa.Integer(), nullable=False),
        sa.Column("omega_rad_s", sa.LargeBinary(), nullable=False),
        sa.Column("z", sa.LargeBinary(), nullable=False),
        sa.Column("variance", sa.LargeBinary(), nullable=False),
        sa.Column("segments", sa.Integer(), nullable=False),
        sa.Column("quality", sa.Text(), nullable=False),
        sa.Column("usable", sa.Boolean(), nullable=False),
        sa.Column("measured_at", sa.DateTime(), nullable=False),
        sa.ForeignKeyConstraint(
            ["fleet", "robot"],
            ["robots.fleet", "robots.robot"],
            name=op.f("fk_responses_fleet_robot"),
        ),
        sa.ForeignKeyConstraint(["goal_id"], ["trials.goal_id"], name=op.f("fk_responses_goal_id")),
        sa.PrimaryKeyConstraint("goal_id", name=op.f("pk_responses")),
    )
    op.create_index(
        op.f("ix_responses_fleet_responses_robot_responses_axis"),
        "responses",
        ["fleet", "robot", "axis"],
        unique=False,
    )
    op.create_table(
        "samples",
        sa.Column("goal_id", sa.Text(), nullable=False),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("reference", sa.LargeBinary(), nullable=False),
        sa.Column("response", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["goal_id"], ["trials.goal_id"], name=op.f("fk_samples_goal_id")),
        sa.PrimaryKeyConstraint("goal_id", name=op.f("pk_samples")),
    )

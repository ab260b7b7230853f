"""The first schema: airframes, their flights with the monitors' figures and the rotors' trim, maintenance marks."""

import sqlalchemy as sa
from alembic import op

__all__ = ["downgrade", "upgrade"]

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "mavdiag_airframe",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("name", sa.String(200), nullable=False, unique=True),
    )
    op.create_table(
        "mavdiag_flight",
        sa.Column("id", sa.Integer, primary_key=True),
        _of("airframe", nullable=False),
        sa.Column("content", sa.String(100), nullable=False),
        sa.Column("log", sa.Text, nullable=False),
        sa.Column("started_ns", sa.BigInteger, nullable=False),
        sa.Column("added_ns", sa.BigInteger, nullable=False),
        sa.Column("baseline", sa.String(100), nullable=False),
        sa.Column("verdict", sa.String(20), nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("judged_s", sa.Float(53), nullable=False),
        sa.UniqueConstraint("content", name="mavdiag_flight_once"),
    )
    op.create_index("mavdiag_flight_airframe", "mavdiag_flight", ["airframe_id"])
    op.create_table(
        "mavdiag_figure",
        _of("flight", primary_key=True),
        sa.Column("monitor", sa.String(40), primary_key=True),
        sa.Column("axis", sa.String(10), primary_key=True),
        sa.Column("place", sa.Integer, nullable=False),
        sa.Column("unit", sa.String(40), nullable=False),
        sa.Column("threshold", sa.Float(53), nullable=False),
        sa.Column("median", sa.Float(53)),
        sa.Column("peak", sa.Float(53)),
        sa.Column("judged_s", sa.Float(53), nullable=False),
    )
    op.create_table(
        "mavdiag_rotor",
        _of("flight", primary_key=True),
        sa.Column("rotor", sa.Integer, primary_key=True),
        sa.Column("trim", sa.Float(53), nullable=False),
    )
    op.create_table(
        "mavdiag_mark",
        sa.Column("id", sa.Integer, primary_key=True),
        _of("airframe", nullable=False),
        sa.Column("t_ns", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(40), nullable=False),
        sa.Column("note", sa.Text, nullable=False),
    )
    op.create_index("mavdiag_mark_airframe", "mavdiag_mark", ["airframe_id"])


def downgrade() -> None:
    """Remove them, with all that they hold."""
    for name in ("mark", "rotor", "figure", "flight", "airframe"):
        op.drop_table(f"mavdiag_{name}")


def _of(table: str, *, primary_key: bool = False, nullable: bool = False) -> sa.Column[int]:
    return sa.Column(
        f"{table}_id",
        sa.Integer,
        sa.ForeignKey(f"mavdiag_{table}.id", ondelete="CASCADE"),
        primary_key=primary_key,
        nullable=nullable,
    )

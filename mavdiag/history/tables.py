"""The tables of the history, as SQLAlchemy knows them. `migrations` makes them; this describes the newest schema.

    airframe 1─n flight 1─n figure      one row for each monitor and axis
                        1─n rotor       one row for each rotor
             1─n mark

Times are whole nanoseconds of the unix epoch (0: unknown). An axis that there is not is the empty text, for it is part
of a key. The names begin with mavdiag_, for a fleet's database may hold other things.
"""

from sqlalchemy import (
    BigInteger,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)

__all__ = ["AIRFRAME", "FIGURE", "FLIGHT", "MARK", "METADATA", "ROTOR", "VERSION"]

METADATA = MetaData()

VERSION = "mavdiag_version"  # the table that says which schema it is

AIRFRAME = Table(
    "mavdiag_airframe",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("name", String(200), nullable=False, unique=True),
)

FLIGHT = Table(
    "mavdiag_flight",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("airframe_id", ForeignKey("mavdiag_airframe.id", ondelete="CASCADE"), nullable=False),
    Column("content", String(100), nullable=False),
    Column("log", Text, nullable=False),
    Column("started_ns", BigInteger, nullable=False),
    Column("added_ns", BigInteger, nullable=False),
    Column("baseline", String(100), nullable=False),
    Column("verdict", String(20), nullable=False),
    Column("reason", Text, nullable=False),
    Column("judged_s", Float(53), nullable=False),
    UniqueConstraint("content", name="mavdiag_flight_once"),
    Index("mavdiag_flight_airframe", "airframe_id"),
)

FIGURE = Table(
    "mavdiag_figure",
    METADATA,
    Column("flight_id", ForeignKey("mavdiag_flight.id", ondelete="CASCADE"), primary_key=True),
    Column("monitor", String(40), primary_key=True),
    Column("axis", String(10), primary_key=True),
    Column("place", Integer, nullable=False),
    Column("unit", String(40), nullable=False),
    Column("threshold", Float(53), nullable=False),
    Column("median", Float(53)),
    Column("peak", Float(53)),
    Column("judged_s", Float(53), nullable=False),
)

ROTOR = Table(
    "mavdiag_rotor",
    METADATA,
    Column("flight_id", ForeignKey("mavdiag_flight.id", ondelete="CASCADE"), primary_key=True),
    Column("rotor", Integer, primary_key=True),
    Column("trim", Float(53), nullable=False),
)

MARK = Table(
    "mavdiag_mark",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("airframe_id", ForeignKey("mavdiag_airframe.id", ondelete="CASCADE"), nullable=False),
    Column("t_ns", BigInteger, nullable=False),
    Column("kind", String(40), nullable=False),
    Column("note", Text, nullable=False),
    Index("mavdiag_mark_airframe", "airframe_id"),
)

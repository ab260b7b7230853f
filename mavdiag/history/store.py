"""Where histories are kept (edge): an SQLite file, or a PostgreSQL database for a fleet.

A database is made, or brought to the newest schema, by Alembic when it is opened to write. All that SQLAlchemy
reports comes out as UsageError in one line; a password in an address is never shown.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Connection, Engine, create_engine, delete, event, insert, inspect, select, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, IntegrityError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from mavdiag.errors import InputError, UsageError, missing_extra
from mavdiag.history.records import FlightRecord, Mark, MarkKind, SlotFigures
from mavdiag.history.tables import AIRFRAME, FIGURE, FLIGHT, MARK, ROTOR, VERSION
from mavdiag.judging import Verdict
from mavdiag.telemetry import Axis

__all__ = ["History", "address_of", "open_history"]

SCRIPTS = "mavdiag.history:migrations"
UPGRADE_LOCK = 0x6D617664  # of PostgreSQL: two that upgrade at once wait for each other
BUSY_S = 30  # how long SQLite waits for another that writes (our choice)


class History:
    """An open history; made by `open_history`. Every method is a transaction of its own."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def airframe_of(self, content: str) -> str | None:
        """The airframe that has a flight of this content; None if there is no such flight."""
        query = select(AIRFRAME.c.name).join(FLIGHT).where(FLIGHT.c.content == content)
        with self._engine.begin() as connection:
            return connection.execute(query).scalar()

    def add(self, record: FlightRecord, *, again: bool = False) -> bool:
        """Keep a flight. False, and nothing is changed, if it is there already; with `again` the new one replaces it.

        Raises UsageError if the database fails.
        """
        try:
            with self._engine.begin() as connection:
                if again:
                    connection.execute(delete(FLIGHT).where(FLIGHT.c.content == record.content))
                _insert(connection, record)
        except IntegrityError:
            if self.airframe_of(record.content) is None:
                raise
            return False
        return True

    def mark(self, mark: Mark) -> None:
        """Keep a maintenance mark. Raises UsageError for an airframe without flights."""
        with self._engine.begin() as connection:
            names = _names(connection)
            if mark.airframe not in names:
                raise UsageError(f"no airframe {mark.airframe!r} in the history; there is {', '.join(names) or 'none'}")
            airframe = connection.execute(select(AIRFRAME.c.id).where(AIRFRAME.c.name == mark.airframe)).scalar_one()
            values = {"airframe_id": airframe, "t_ns": mark.t_ns, "kind": mark.kind.value, "note": mark.note}
            connection.execute(insert(MARK).values(values))

    def airframes(self) -> tuple[str, ...]:
        """Names of those that have flights, in order."""
        with self._engine.begin() as connection:
            return _names(connection)

    def flights(self, airframe: str) -> tuple[FlightRecord, ...]:
        """All of an airframe, in order of time; those without a time by when they were added."""
        of_it = FLIGHT.join(AIRFRAME)
        own = AIRFRAME.c.name == airframe
        with self._engine.begin() as connection:
            rows = connection.execute(select(FLIGHT).select_from(of_it).where(own).order_by(FLIGHT.c.id)).all()
            figures = connection.execute(
                select(FIGURE).select_from(FIGURE.join(of_it)).where(own).order_by(FIGURE.c.flight_id, FIGURE.c.place)
            ).all()
            trims = connection.execute(
                select(ROTOR).select_from(ROTOR.join(of_it)).where(own).order_by(ROTOR.c.flight_id, ROTOR.c.rotor)
            ).all()
        slots: dict[int, list[SlotFigures]] = {}
        for one in figures:
            axis = Axis(one.axis) if one.axis else None
            told = (one.unit, one.threshold, one.median, one.peak, one.judged_s)
            slots.setdefault(one.flight_id, []).append(SlotFigures(one.monitor, axis, *told))
        rotors: dict[int, list[float]] = {}
        for trim in trims:
            rotors.setdefault(trim.flight_id, []).append(trim.trim)
        found = [
            FlightRecord(
                airframe,
                row.log,
                row.content,
                row.started_ns,
                row.added_ns,
                row.baseline,
                Verdict(row.verdict),
                row.reason,
                row.judged_s,
                tuple(slots.get(row.id, ())),
                tuple(rotors.get(row.id, ())),
            )
            for row in rows
        ]
        return tuple(sorted(found, key=lambda record: record.t_ns))

    def marks(self, airframe: str) -> tuple[Mark, ...]:
        """All of an airframe, in order of time."""
        query = select(MARK).select_from(MARK.join(AIRFRAME)).where(AIRFRAME.c.name == airframe)
        with self._engine.begin() as connection:
            rows = connection.execute(query.order_by(MARK.c.t_ns, MARK.c.id)).all()
        return tuple(Mark(airframe, row.t_ns, MarkKind(row.kind), row.note) for row in rows)


@contextmanager
def open_history(database: str, *, create: bool = False, write: bool = False) -> Iterator[History]:
    """A history, by the path of its SQLite file or a URL such as postgresql://user@host/fleet.

    create: make the SQLite file if there is none.
    write: something will be kept: the database gets its tables or the newest schema, and an SQLite file is locked from
        the begin of each transaction. `create` implies it. A reader changes nothing.
    Raises UsageError if it cannot be used, also out of the block.
    """
    url = address_of(database)
    shown = url.database or "" if url.get_backend_name() == "sqlite" else url.render_as_string(hide_password=True)
    if url.get_backend_name() == "sqlite":
        _check_file(Path(url.database or ""), create)
    try:
        engine = _engine(url, "BEGIN IMMEDIATE" if create or write else "BEGIN")
        try:
            _bring_up(engine, shown, write=create or write)
            yield History(engine)
        finally:
            engine.dispose()
    except CommandError as error:
        raise UsageError(f"{shown}: made by a newer mavdiag ({error}); update this one") from error
    except ImportError as error:
        raise missing_extra(shown, f"a driver ({error})", "history") from error
    except SQLAlchemyError as error:
        raise UsageError(f"{shown}: the history cannot be used ({_first_line(error)})") from error


def address_of(database: str) -> URL:
    """What SQLAlchemy connects to. Raises UsageError for an address of another kind of database.

    >>> address_of("fleet.sqlite").render_as_string(), address_of("postgres://me@host/fleet").render_as_string()
    ('sqlite:///fleet.sqlite', 'postgresql+psycopg://me@host/fleet')
    """
    if "://" not in database:
        if not database:
            raise UsageError("name the history: a file, or a URL like postgresql://user@host/name")
        return URL.create("sqlite", database=database)
    try:
        url = make_url(database)
    except (ArgumentError, ValueError) as error:  # its text would repeat the password
        raise UsageError("the address of the history is no URL; write postgresql://user@host/name") from error
    kind = url.drivername.partition("+")[0]
    if kind in ("postgresql", "postgres"):
        return url.set(drivername="postgresql+psycopg")
    if kind == "sqlite" and url.database and url.database != ":memory:":
        return URL.create("sqlite", database=url.database)
    raise UsageError(f"a history is an SQLite file or a postgresql:// URL, not {kind}://")


def _check_file(path: Path, create: bool) -> None:
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; name the file of a history")
    if path.exists() and not path.is_file():
        raise UsageError(f"{path}: is not a regular file; name the file of a history")
    if not path.exists() and not create:
        raise InputError(f"{path}: no history there; make one with `mavdiag history add`, or name it by --database")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}; make it, or name another file")


def _engine(url: URL, begin: str) -> Engine:
    """begin: how SQLite begins a transaction; a reader must not need rights to write."""
    if url.get_backend_name() != "sqlite":
        return create_engine(url, poolclass=NullPool)
    engine = create_engine(url, poolclass=NullPool, connect_args={"timeout": BUSY_S, "isolation_level": None})

    @event.listens_for(engine, "connect")
    def connected(connection: object, record: object) -> None:
        connection.execute("PRAGMA foreign_keys=ON")  # type: ignore[attr-defined]

    @event.listens_for(engine, "begin")
    def begun(connection: Connection) -> None:
        connection.exec_driver_sql(begin)

    return engine


def _bring_up(engine: Engine, shown: str, *, write: bool) -> None:
    """Migrate to the newest schema if it is opened to write. Raises UsageError for a reader of an older one."""
    config = Config()
    config.set_main_option("script_location", SCRIPTS)
    config.set_main_option("path_separator", "os")
    scripts = ScriptDirectory.from_config(config)
    with engine.begin() as connection:
        version = _version(connection)
        if version == scripts.get_heads():
            return
        for one in version:
            scripts.get_revision(one)  # CommandError if a newer mavdiag made it
        if not write:
            what = "its tables are of an older mavdiag" if version else "there is no history in it yet"
            raise UsageError(f"{shown}: {what}; `mavdiag history add` or `mark` bring it up to date")
        if connection.dialect.name == "postgresql":
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": UPGRADE_LOCK})
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def _version(connection: Connection) -> list[str]:
    context = MigrationContext.configure(connection, opts={"version_table": VERSION})
    return list(context.get_current_heads()) if inspect(connection).has_table(VERSION) else []


def _names(connection: Connection) -> tuple[str, ...]:
    query = select(AIRFRAME.c.name).join(FLIGHT).distinct().order_by(AIRFRAME.c.name)
    return tuple(connection.execute(query).scalars())


def _insert(connection: Connection, record: FlightRecord) -> None:
    airframe = connection.execute(select(AIRFRAME.c.id).where(AIRFRAME.c.name == record.airframe)).scalar()
    if airframe is None:
        made = connection.execute(insert(AIRFRAME).values(name=record.airframe).returning(AIRFRAME.c.id))
        airframe = made.scalar_one()
    row = {
        "airframe_id": airframe,
        "content": record.content,
        "log": record.log,
        "started_ns": record.started_ns,
        "added_ns": record.added_ns,
        "baseline": record.baseline,
        "verdict": record.verdict.value,
        "reason": record.reason,
        "judged_s": record.judged_s,
    }
    flight = connection.execute(insert(FLIGHT).values(row).returning(FLIGHT.c.id)).scalar_one()
    figures = [
        {
            "flight_id": flight,
            "monitor": one.monitor,
            "axis": one.axis.value if one.axis else "",
            "place": place,
            "unit": one.unit,
            "threshold": one.threshold,
            "median": one.median,
            "peak": one.peak,
            "judged_s": one.judged_s,
        }
        for place, one in enumerate(record.slots)
    ]
    trims = [{"flight_id": flight, "rotor": n, "trim": trim} for n, trim in enumerate(record.rotor_trim, 1)]
    if figures:
        connection.execute(insert(FIGURE), figures)
    if trims:
        connection.execute(insert(ROTOR), trims)


def _first_line(error: SQLAlchemyError) -> str:
    origin = getattr(error, "orig", None) or error
    return str(origin).strip().splitlines()[0]

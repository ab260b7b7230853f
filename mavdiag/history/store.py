"""Where histories are kept (edge): an SQLite file, or a PostgreSQL database for a fleet.

Times are whole nanoseconds of the unix epoch. The names begin with mavdiag_, for a fleet's database may hold other
things. All that SQLAlchemy reports comes out as UsageError in one line; a password in an address is never shown.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from json import JSONDecodeError
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import sqlalchemy as sa
from pydantic import TypeAdapter, ValidationError
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, IntegrityError, SQLAlchemyError
from sqlalchemy.pool import NullPool
from sqlalchemy.types import TypeEngine

from mavdiag.archive.figures import FlightRecord
from mavdiag.archive.together import Reference
from mavdiag.errors import InputError, UsageError, missing_extra
from mavdiag.history.warn import Mark, MarkKind
from mavdiag.judging import Verdict

METADATA = sa.MetaData()
SCHEMA = "4"  # of these tables


def _table(name: str, kept: type) -> sa.Table:
    kinds: dict[type, TypeEngine[Any]] = {int: sa.BigInteger(), float: sa.Float(53)}
    kinds |= dict.fromkeys((str, Verdict, MarkKind), sa.Text())
    columns: list[sa.Column[Any]] = []
    for field, kind in get_type_hints(kept).items():
        unique, index = field == "content" or (kept is Reference and field == "baseline"), field == "airframe"
        columns.append(sa.Column(field, kinds.get(kind, sa.JSON()), nullable=False, index=index, unique=unique))
    return sa.Table(f"mavdiag_{name}", METADATA, sa.Column("id", sa.Integer, primary_key=True), *columns)


FLIGHT, MARK, REFERENCE = _table("flight", FlightRecord), _table("mark", Mark), _table("reference", Reference)
VERSION = sa.Table("mavdiag_version", METADATA, sa.Column("version_num", sa.String(32), primary_key=True))
MAKE_LOCK = 0x6D617664  # of PostgreSQL: two that make the tables at once wait for each other
BUSY_S = 30  # how long SQLite waits for another that writes (our choice)
_FLIGHTS, _MARKS, _REFERENCES = TypeAdapter(FlightRecord), TypeAdapter(Mark), TypeAdapter(Reference)
Kept = TypeVar("Kept", FlightRecord, Mark, Reference)


class History:
    """An open history; made by `open_history`. Every method is a transaction of its own."""

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def kept_as(self, content: str) -> tuple[str, str] | None:
        """Airframe and baseline of the flight that has this content; None if there is no such flight."""
        with self._engine.begin() as connection:
            query = sa.select(FLIGHT.c.airframe, FLIGHT.c.baseline).where(FLIGHT.c.content == content)
            found = connection.execute(query).first()
            return None if found is None else (found[0], found[1])

    def add(self, record: FlightRecord, *, again: bool = False) -> bool:
        """Keep a flight. False, with nothing changed, if it is there already; with `again` the new one replaces it."""
        try:
            with self._engine.begin() as connection:
                if again:  # it keeps its place
                    there = sa.select(FLIGHT.c.started_ns, FLIGHT.c.added_ns).where(FLIGHT.c.content == record.content)
                    for started_ns, added_ns in connection.execute(there).all():
                        record = replace(record, started_ns=record.started_ns or started_ns, added_ns=added_ns)
                    connection.execute(sa.delete(FLIGHT).where(FLIGHT.c.content == record.content))
                connection.execute(sa.insert(FLIGHT).values(_FLIGHTS.dump_python(record, mode="json")))
        except IntegrityError:
            if self.kept_as(record.content) is None:
                raise
            return False
        return True

    def refer(self, reference: Reference) -> None:
        """Keep what the flights of a baseline are compared with, once."""
        with suppress(IntegrityError), self._engine.begin() as connection:  # it is there
            connection.execute(sa.insert(REFERENCE).values(_REFERENCES.dump_python(reference, mode="json")))

    def mark(self, mark: Mark) -> None:
        """Keep a maintenance mark. Raises UsageError for an airframe without flights."""
        self.names(mark.airframe)
        with self._engine.begin() as connection:
            connection.execute(sa.insert(MARK).values(_MARKS.dump_python(mark, mode="json")))

    def names(self, airframe: str | None = None) -> tuple[str, ...]:
        """Airframes that have flights, in order; or the one asked for. Raises UsageError if there is none such."""
        with self._engine.begin() as connection:
            known = tuple(sorted(connection.scalars(sa.select(FLIGHT.c.airframe).distinct())))
        if not known:
            raise UsageError("no flight is in the history yet; add one with `mavdiag history add`")
        if airframe not in (None, *known):
            raise UsageError(f"no airframe {airframe!r} in the history; there is {', '.join(known)}")
        return known if airframe is None else (airframe,)

    def flights(self, airframe: str) -> tuple[FlightRecord, ...]:
        """All of an airframe, in order of time; those without a time by when they were added."""
        return tuple(sorted(self._all(FLIGHT, _FLIGHTS, airframe=airframe), key=lambda flight: flight.t_ns))

    def marks(self, airframe: str) -> tuple[Mark, ...]:
        """All of an airframe, in order of time."""
        return tuple(sorted(self._all(MARK, _MARKS, airframe=airframe), key=lambda mark: mark.t_ns))

    def references(self) -> tuple[Reference, ...]:
        """What the flights of each baseline are compared with."""
        return self._all(REFERENCE, _REFERENCES)

    def _all(self, table: sa.Table, values: TypeAdapter[Kept], **only: str) -> tuple[Kept, ...]:
        columns = [column for column in table.c if column is not table.c.id]
        query = sa.select(*columns).filter_by(**only).order_by(table.c.id)
        with self._engine.begin() as connection:
            return tuple(values.validate_python(dict(row)) for row in connection.execute(query).mappings())


@contextmanager
def open_history(database: str, *, create: bool = False, write: bool = False) -> Iterator[History]:
    """A history, by the path of its SQLite file or a URL such as postgresql://user@host/fleet.

    write: the database gets its tables, and an SQLite file is locked from the begin of each transaction. create: also
    make the SQLite file. Raises UsageError if it cannot be used, also out of the block.
    """
    url, write = address_of(database), create or write
    is_file = url.get_backend_name() == "sqlite"
    shown = url.database or "" if is_file else url.render_as_string(hide_password=True)
    if is_file:
        _check_file(Path(shown), create)
    busy = {"connect_args": {"timeout": BUSY_S, "isolation_level": None}} if is_file else {}
    try:
        engine = sa.create_engine(url, poolclass=NullPool, **busy)
        if is_file:  # a reader must not need rights to write
            begin = "BEGIN IMMEDIATE" if write else "BEGIN"
            sa.event.listen(engine, "begin", lambda connection: connection.exec_driver_sql(begin))
        try:
            _check_tables(engine, shown, write=write)
            yield History(engine)
        finally:
            engine.dispose()
    except ImportError as error:
        raise missing_extra(shown, f"a driver ({error})", "history") from error
    except (SQLAlchemyError, ValidationError, JSONDecodeError) as error:
        line = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        raise UsageError(f"{shown}: the history cannot be used ({line}); mend that, or name another one") from error


def address_of(database: str) -> URL:
    """What SQLAlchemy connects to. Raises UsageError for an address of another kind of database."""
    if not database:
        raise UsageError("name the history: a file, or a URL like postgresql://user@host/name")
    if "://" not in database:
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
    if path.exists() and not path.is_file():
        raise UsageError(f"{path}: is {'a folder' if path.is_dir() else 'not a regular file'}; name a history's file")
    if not path.exists() and not create:
        raise InputError(f"{path}: no history there; make one with `mavdiag history add`, or name it by --database")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}; make it, or name another file")


def _check_tables(engine: sa.Engine, shown: str, *, write: bool) -> None:
    with engine.begin() as connection:
        if connection.dialect.name == "postgresql" and write:
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(MAKE_LOCK)))
        if sa.inspect(connection).has_table(VERSION.name):
            found = connection.scalars(sa.select(VERSION.c.version_num)).all()
            if found != [SCHEMA]:
                words = f"its tables are of schema {', '.join(found)}, this mavdiag has {SCHEMA}"
                raise UsageError(f"{shown}: {words}; add the logs to a new history")
        elif not write:
            raise UsageError(f"{shown}: there is no history in it yet; `mavdiag history add` makes one")
        else:
            METADATA.create_all(connection)
            connection.execute(sa.insert(VERSION).values(version_num=SCHEMA))

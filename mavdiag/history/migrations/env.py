"""What Alembic runs to migrate: on the connection that the store hands over, in one transaction."""

from alembic import context

from mavdiag.history.tables import METADATA, VERSION

__all__ = ["migrate"]

AS_ALEMBIC_LOADS_IT = "env_py"


def migrate() -> None:
    """Run the migrations that Alembic was asked for."""
    connection = context.config.attributes["connection"]
    context.configure(connection, target_metadata=METADATA, version_table=VERSION, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()


if __name__ == AS_ALEMBIC_LOADS_IT:  # imported by anything else it does nothing
    migrate()

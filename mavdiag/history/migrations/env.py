"""What Alembic runs to migrate: on the connection that the store hands over, in one transaction."""

from alembic import context

from mavdiag.history.tables import METADATA, VERSION

__all__: list[str] = []

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=METADATA,
    version_table=VERSION,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()

"""The schema of the history, version by version; `mavdiag.history.store` brings a database to the newest by itself."""

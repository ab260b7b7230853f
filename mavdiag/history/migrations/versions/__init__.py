"""One file for each version of the schema, in order. A file that was released is never changed."""

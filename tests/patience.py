"""How long tests with processes and sockets wait before they give up: a machine with much to do is slow, not wrong."""

PATIENCE_S = 120.0

"""The MAVLink side: bytes to frames (`codec`), frames to SI (`samples`), links to vehicles (`vehicles`), the ports."""

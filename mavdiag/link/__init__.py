"""The MAVLink side: bytes to frames (`codec`), counters to time (`clock`), frames to SI (`samples`), and the ports."""

"""The detector: a daemon that watches vehicles over MAVLink and reports when a propeller is damaged."""

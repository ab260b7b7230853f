"""The closed loop of emulator, detector and ground station, as processes that are started by module name."""

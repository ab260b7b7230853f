"""The closed loop of emulator, detector and ground station, shown to a person."""

"""What a terminal shows of a flight while it goes on: strips of the rates and residual, the monitors, the events."""

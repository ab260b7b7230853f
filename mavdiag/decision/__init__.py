"""What the monitors add up to: alarms, the one decision about the vehicle, the rotor, and the kind of fault."""

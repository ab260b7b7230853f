"""The plant under an autopilot outside: a real one, in simulation or on its own hardware."""

"""The emulated autopilot: streams, schedules, dialects, commands."""

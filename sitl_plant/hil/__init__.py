"""The plant under an autopilot outside: a real one, in simulation or on its own hardware.

simulation    the plant, step by step, with what is to happen in its flight
outputs       an autopilot's outputs become duties
parameters    the file of suggested parameters
ardupilot     ArduPilot's JSON physics: bytes in, bytes out
px4           PX4's simulator messages and a flight controller in HIL mode: frames in, frames out
instruments   what compass, barometer and GPS show
command       the commands `serve-ardupilot`, `serve-px4` and `serve-hil` (edge)
serve         their loops (edge); `datagrams` has the socket
"""

"""A software-in-the-loop multirotor, by default a QDrone 2, seen over MAVLink; `sitl_plant.plant.Plant` is its core.

trajectory ▶ controller ▶ mixer ▶ rotors × faults ▶ rigid body ▶ sensors ▶ attitude estimate ┐
     ▲                                                                └─ motion capture ─────┤
     └───────────────────────────────────────────────────────────────────────────────────────┘
"""

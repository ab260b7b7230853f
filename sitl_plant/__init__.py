"""A software-in-the-loop multirotor, by default a QDrone 2, seen over MAVLink.

Flight dynamics, control, sensors and propeller faults:

    trajectory ▶ controller ▶ mixer ▶ rotors × faults ▶ rigid body ▶ sensors ▶ attitude estimate ┐
         ▲                                                                └─ motion capture ─────┤
         └───────────────────────────────────────────────────────────────────────────────────────┘

`sitl_plant.plant` has the one class to use, `Plant`.
"""

"""The closed loop of emulator, detector and ground station, shown to a person.

This folder starts `sitl_plant` and `detector` as processes, by module name: the one place where the library depends on
them, at run time only, which no import contract can see. Both come with this distribution.
"""

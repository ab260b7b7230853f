"""The vehicle as physics: rigid body, rotors, sensors, supply, and the thesis's controller."""

"""Small reference detectors of the families that T 1.3 reviews, and the common ground to compare them on."""

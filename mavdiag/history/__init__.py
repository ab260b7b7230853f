"""The history of an airframe: how near its statistics came to their thresholds, flight by flight, and what follows."""

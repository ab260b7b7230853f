"""The history of an airframe: flight by flight, how near its statistics come to their thresholds, and where it leads."""

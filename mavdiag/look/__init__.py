"""What a log or a link shows by itself, without a baseline: what arrives, and a first look at the flight."""

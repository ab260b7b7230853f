"""The live page: what the detector sees and concludes, in a browser (`--web HOST:PORT`, extra `web`)."""

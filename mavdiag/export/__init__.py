"""Baselines for those who judge without this package: a script for the flight controller."""

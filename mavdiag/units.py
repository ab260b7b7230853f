"""Conversion factors, each written once. Everything inside is in SI units; these stand where other units come in."""

import math

DEG = math.pi / 180  # rad
RPM = 2 * math.pi / 60  # rad/s
G = 9.80665  # standard gravity [m/s^2]
G_MM_PER_KG_M = 1e6  # unbalance: g mm in one kg m
S_PER_H = 3600.0
NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000
NS_PER_US = 1_000

"""The daemon for hours: does memory grow, does a verdict come late, is an alert missed?

    PYTHONPATH=tests python benchmarks/soak.py virtual [--hours 24] [--cpu-minutes 20] [--rate 1000] [--seed 31]
    PYTHONPATH=tests python benchmarks/soak.py real [--minutes 20] [--rate 1000] [--seed 31]

virtual: one recorded loop of the emulated quadrotor is sent again and again with later stamps through the fleet, on a
virtual clock with the default tick. Now and then a loop with a fault is put in, and must be declared. Stops at the hours
asked for, or when the processor time is used up, and says which.
real: emulator and daemon as processes over UDP on loopback; every few minutes another emulated flight begins, some of
them with a fault, so reboots are in it as well.

Memory is the resident set; its growth is that of a straight line through it after the first tenth. The latency of a
verdict is from the arrival of a gyro sample to the end of the look in which the row of that sample was judged.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from bad_link import taught

from detector.config import SessionSettings
from detector.fleet import Fleet
from detector.values import SendText, SessionSpec
from mavdiag.baseline import Baseline
from mavdiag.link.codec import Decoder, Encoder, Frame
from mavdiag.link.conversion import SOURCES
from mavdiag.link.layout import Layout
from mavdiag.link.messages import Severity
from mavdiag.telemetry import Instant
from mavdiag.units import NS_PER_S
from sitl_plant.autopilot.dialect import dialect_named
from sitl_plant.options import FlightPlan
from sitl_plant.plant import PlantConfig
from sitl_plant.recording import recorded

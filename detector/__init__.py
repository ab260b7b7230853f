"""The detector: a daemon that watches vehicles over MAVLink and reports when a propeller is damaged."""

import gc

from mavdiag.storage import COLLECT_AT

gc.set_threshold(COLLECT_AT)  # before what stays is imported: to go through it again and again is a tenth of the start

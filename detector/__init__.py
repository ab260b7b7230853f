"""The detector: a daemon that watches vehicles over MAVLink and reports when a propeller is damaged.

endpoint ─bytes▶ fleet ─one inbox a vehicle▶ session ─effects▶ daemon ─▶ STATUSTEXT, journal, metrics, page
"""

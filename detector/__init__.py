"""The detector: a daemon that watches vehicles over MAVLink and reports when a propeller is damaged.

    endpoint ─bytes▶ fleet ─one inbox a vehicle▶ session ─effects▶ daemon ─▶ STATUSTEXT, journal, metrics, page

`session` and what it is made of take values and `now` and return values. Sockets, files, clocks and processes live in
`daemon`, `relay`, `journal`, `appender`, `fitting`, `metrics`, `notify`, `check`,
`__main__` and in `web`, the live page.
"""

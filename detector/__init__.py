"""The detector: a daemon that listens to vehicles over MAVLink and says when a propeller is damaged.

    endpoint ─bytes▶ fleet ─one inbox a vehicle▶ session ─effects▶ daemon ─▶ STATUSTEXT, journal, metrics

`session` and what it is made of (`states`, `streams`, `collect`, `negotiate`, `alerts`, `twins`) are pure: values and
`now` in, values out. Sockets, files, clocks and processes live in `daemon`, `journal`, `fitting`, `metrics` and
`__main__`.
"""

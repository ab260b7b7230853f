"""The detector: a daemon that watches vehicles over MAVLink and reports when a propeller is damaged.

    endpoint ─bytes▶ fleet ─one inbox a vehicle▶ session ─effects▶ daemon ─▶ STATUSTEXT, journal, metrics

`session` and what it is made of are pure: values and `now` in, values out. `states` has the table of its states,
`values` what goes in and comes out, `streams` the measured rates, `negotiate` the requests for streams, `judging` the
chain at work, `alerts` the texts, `named_values` the figures; `sender` encodes them. `requests` answers ground
stations, by `rate_guard` and `own_parameters`; `latency` and `figures` are what is measured. Sockets, files, clocks
and processes live in `daemon`, `relay`, `reporting`, `journal`, `appender`, `fitting`, `metrics`, `notify`, `health`,
`check` and `__main__`. `web` is the live page.
"""

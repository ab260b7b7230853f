"""The live page: what the detector sees and concludes, in a browser (`--web HOST:PORT`, extra `web`).

    daemon ─ feed ─ child ─pipe─▶ server ─ board ─server-sent events─▶ page/app.js

`snapshot`, `access` and `board` are pure. `feed` chooses what is sent and when, and never waits; `child` holds the
process of the server and its pipes; `server` is that process. The pages share nothing with the daemon but these pipes:
one that hangs, floods or crashes the server costs the watch nothing.
"""

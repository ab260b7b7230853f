"""The live page: what the detector sees and concludes, in a browser (`--web HOST:PORT`, extra `web`).

daemon ─ feed ─ child ─pipe─▶ server ─ board ─server-sent events─▶ page/app.js
"""

"""How many lines each room of the house has, beside its budget: `python benchmarks/size.py`.

A line is any line of a .py file: code, documentation and blank lines. A file belongs to the first room that names it.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS: dict[str, tuple[int, tuple[str, ...]]] = {
    "kernel, rows, monitors": (3000, ("mavdiag/kernel.py", "mavdiag/rows", "mavdiag/monitors")),
    "top": (1500, ("mavdiag/*.py",)),
    "thresholds, learning, decision": (2000, ("mavdiag/thresholds", "mavdiag/learning", "mavdiag/decision")),
    "airframe": (1200, ("mavdiag/airframe",)),
    "identify": (1000, ("mavdiag/identify",)),
    "link": (3400, ("mavdiag/link",)),
    "logs": (1600, ("mavdiag/logs",)),
    "look": (700, ("mavdiag/look",)),
    "archive, history, commands": (2500, ("mavdiag/archive", "mavdiag/history", "mavdiag/commands")),
    "report, terminal, demo": (2600, ("mavdiag/report", "mavdiag/terminal", "mavdiag/demo")),
    "detector": (4000, ("detector",)),
    "sitl_plant": (6500, ("sitl_plant",)),
    "all": (30000, ("mavdiag", "detector", "sitl_plant")),
    "tests": (22000, ("tests",)),
}


def files_of(places: tuple[str, ...]) -> set[Path]:
    """The files of some folders or patterns."""
    patterns = (place if place.endswith(".py") else f"{place}/**/*.py" for place in places)
    return {file for pattern in patterns for file in ROOT.glob(pattern)}


if __name__ == "__main__":
    print(f"{'room':32}{'lines':>8}{'budget':>8}")
    counted = set[Path]()
    for room, (budget, places) in ROOMS.items():
        files = files_of(places) - (set() if room == "all" else counted)
        counted |= files
        lines = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)
        print(f"{room:32}{lines:8}{budget:8}")

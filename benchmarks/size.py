"""How many lines each room of the house has, beside its budget: `python benchmarks/size.py`.

A line is any line of a .py file: code, documentation and blank lines.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS: dict[str, tuple[int, tuple[str, ...]]] = {
    "top": (1500, ("mavdiag/*.py",)),
    "rows, monitors": (3000, ("mavdiag/rows", "mavdiag/monitors")),
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


def lines(places: tuple[str, ...]) -> int:
    """Lines of the files of some folders or patterns."""
    files = [file for place in places for file in (ROOT.glob(place) if "*" in place else (ROOT / place).rglob("*.py"))]
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


if __name__ == "__main__":
    print(f"{'room':32}{'lines':>8}{'budget':>8}")
    for room, (budget, places) in ROOMS.items():
        print(f"{room:32}{lines(places):8}{budget:8}")

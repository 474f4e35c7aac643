"""Takes the drawings of the book from the page of a sweep, and prints the book's table. Usage: figures.py DIR"""

import csv
import re
import sys
from collections import defaultdict
from pathlib import Path
from statistics import mean

sweep = Path(sys.argv[1])
images = Path(__file__).parent.parent / "how-to" / "images"
page = (sweep / "page.html").read_text()
for svg in re.findall(r"<svg .*?</svg>\n", page, re.S):
    title = re.search(r">([^<>]*), by ([a-z ]+): ([a-z]+)<", svg)
    if title and title[1].startswith("contrast") and title[2] in ("scale", "gain", "finger"):
        (images / f"sweep-{title[2]}-{title[3]}.svg").write_text(svg)

rows = list(csv.DictReader((sweep / "results.csv").open()))
groups = defaultdict(list)
for row in rows:
    for axis in ("scale", "gain"):
        groups[row["model"], axis, row[axis]].append(row)
    groups[row["model"], "all", ""].append(row)


def low(numbers):
    return sorted(numbers)[len(numbers) // 10]


print(f"{len(rows)} cells")
print("| model | cells | contrast | naive-reach | naive-pitch | AUC | naive-reach | naive-pitch |")
print("|---|---|---|---|---|---|---|---|")
for (model, axis, value), own in sorted(groups.items()):
    cells = [model, f"{axis} {value}".strip()]
    for name in ("contrast_hz", "naive_reach_contrast_hz", "naive_pitch_contrast_hz", "auc", "naive_reach_auc", "naive_pitch_auc"):
        numbers = [float(row[name]) for row in own if row[name]]
        digits = 2 if "auc" in name else 1
        cells.append(f"{mean(numbers):.{digits}f} ({low(numbers):.{digits}f})")
    print("| " + " | ".join(cells) + " |")

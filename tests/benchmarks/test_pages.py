"""The pages of the benchmarks: links resolve, and the scoreboard counts the rows of the folders."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "benchmarks"
PAGES = sorted(str(path.relative_to(ROOT)) for path in FOLDER.rglob("*.md"))
TOPICS = sorted(path.parent.name for path in FOLDER.glob("*/README.md"))


def anchor(heading: str) -> str:
    """What GitHub makes of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def anchors(page: Path) -> set[str]:
    return {anchor(heading) for heading in re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)}


def cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.strip().strip("|").split(" | ")]


def tables(page: Path, first: str) -> dict[str, list[list[str]]]:
    """Rows of the tables whose first column is called `first`, by the heading above."""
    heading, inside, rows = "", False, {}
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        if not line.startswith("|"):
            inside = False
        elif line.startswith(f"| {first} |"):
            inside = True
        elif inside and not line.startswith("|--"):
            rows.setdefault(anchor(heading), []).append(cells(line))
    return rows


@pytest.mark.parametrize("name", [*PAGES, "CHANGELOG.md", "CONTRIBUTING.md", "README.md"])
def test_relative_links_resolve(name):
    page = ROOT / name
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        path, _, heading = link.partition("#")
        if re.match(r"[a-z]+:", path):
            continue
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (heading and heading not in anchors(target)):
            broken.append(link)
    assert not broken


def test_the_first_page_is_two_screens():
    lines = (FOLDER / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 100
    assert max(map(len, lines)) <= 150


def test_the_scoreboard_counts_the_rows_of_the_folders():
    asked, missed = {}, 0
    for topic in TOPICS:
        for heading, rows in tables(FOLDER / topic / "README.md", "question").items():
            verdicts = [row[3] for row in rows if row[3] != "–"]
            no = sum("**no**" in verdict for verdict in verdicts)
            yes = sum(verdict.startswith("yes") and "**no**" not in verdict for verdict in verdicts)
            asked[f"{topic}/README.md#{heading}"] = [len(verdicts), yes, no]
            missed += no
            assert [("**no**" in verdict) for verdict in verdicts] == [True] * no + [False] * (
                len(verdicts) - no
            ), f"{topic}: {heading}: rows that are not met stand first"
    board = {}
    for row in tables(FOLDER / "README.md", "topic")["scoreboard"]:
        link = re.search(r"\(([^)]*)\)", row[0])
        assert link is not None
        board[link[1]] = [int(cell) for cell in row[1:]]
    assert board == asked
    assert len(tables(FOLDER / "README.md", "not met")["scoreboard"]) == missed


@pytest.mark.parametrize("topic", TOPICS)
def test_the_page_of_a_folder_names_every_file(topic):
    text = (FOLDER / topic / "README.md").read_text(encoding="utf-8")
    first = (FOLDER / "README.md").read_text(encoding="utf-8")
    for path in (FOLDER / topic).glob("*.py"):
        runs = '__name__ == "__main__"' in path.read_text(encoding="utf-8")
        assert f"`{path.stem}`" in text
        if runs and path.stem not in ("effect_cases", "mutation_judge"):
            assert f"`{path.stem}`" in first

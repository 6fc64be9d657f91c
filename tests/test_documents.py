"""The documents point at what exists, and say what the code and the library say."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / name for name in subprocess.check_output(["git", "ls-files", "*.md"], cwd=ROOT, text=True).split()]
LINK = re.compile(r"\]\(([^()\s]+)\)")
NAMED = re.compile(
    r"`((?:calibration|docs|hardware|perception|policies|resync_robot|scripts|sim_training|tests)/[\w./-]+)`"
)


def _prose(page: Path) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)


def _anchors(page: Path) -> set[str]:
    """What a link's `#...` may name: the headings, as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", _prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def _block(page: Path, language: str) -> str:
    found = re.search(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert found, f"{page} holds no block of {language}"
    return found.group(1)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    broken = []
    for link in LINK.findall(_prose(page)):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            broken.append(link)
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_names_exists(page: Path) -> None:
    assert [name for name in NAMED.findall(_prose(page)) if not (ROOT / name).exists()] == []


def test_every_picture_is_shown() -> None:
    shown = {(page.parent / link).resolve() for page in PAGES for link in LINK.findall(_prose(page))}
    pictures = {path for path in DOCS.iterdir() if path.suffix in (".gif", ".jpg", ".png", ".webp")}
    assert pictures - shown == set()


def test_the_readme_is_a_first_page() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 130


def test_the_readme_describes_every_scenario() -> None:
    from resync_robot.sim_training.domains import find_domain

    rows = re.findall(r"^\| (s\d+) \|", (ROOT / "README.md").read_text("utf-8"), flags=re.MULTILINE)
    assert rows == list(find_domain("cornered-insertion-s").scenarios)


def test_the_actions_that_are_shown_are_those_of_the_shipped_library() -> None:
    from resync_robot.library_models import shipped_library

    shipped = " ".join((shipped_library("cornered-insertion-s") / "domain.pddl").read_text("utf-8").split())
    actions = [f"(:action {words}" for words in _block(DOCS / "method.md", "lisp").split("(:action ")[1:]]
    assert [action.split()[1] for action in actions] == ["Insert", "Pick", "Recover"]
    assert [action for action in actions if " ".join(action.split()) not in shipped] == []


def test_the_example_that_is_shown_is_the_one_that_runs() -> None:
    code = (DOCS / "example.py").read_text("utf-8").split('"""\n', 1)[1].lstrip()
    assert _block(DOCS / "python.md", "python") == code


def test_the_example_reaches_its_goal(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(DOCS / "example.py"), run_name="__main__")
    assert capsys.readouterr().out == _block(DOCS / "python.md", "text")


def test_the_readme_says_what_was_measured() -> None:
    reached = json.loads((DOCS / "results.json").read_text("utf-8"))["series"]["camera"]["reached"]
    counts = [tuple(map(int, words.split(" of "))) for words in reached.values()]
    sums = f"{sum(s for s, _ in counts)} of {sum(n for _, n in counts)} simulated episodes"
    assert sums in (ROOT / "README.md").read_text("utf-8")


def test_the_citation_names_this_version_and_the_paper() -> None:
    from resync_robot import __version__

    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert (citation["cff-version"], citation["version"]) == ("1.2.0", __version__)
    (paper,) = citation["references"]
    readme = " ".join((ROOT / "README.md").read_text("utf-8").split())
    assert f"*{paper['title']}*" in readme
    assert [a for a in paper["authors"] if f"{a['given-names']} {a['family-names']}" not in readme] == []

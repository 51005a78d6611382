# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The documentation site builds without warnings, and its index leads to every subject within two clicks."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import posor
import pytest
from environment import THIS

DOCS = THIS.root / "docs"
MESSAGES = THIS.ros2 / "src" / "posor_msgs" / "msg"
CLICKS = 2
QUESTIONS = {  # what a new reader asks, and a text of the page that answers
    "show the arm live": "posor view",
    "write a stopping rule for a controller": "class StoppingRule",
    "plot the endpoint with its 2-sigma band": 'label="2 sigma"',
}


def build(source: Path, output: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(output / "doctrees")]
    return subprocess.run([*command, str(source), str(output / "html")], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("site")
    done = build(DOCS, output)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return output / "html"


class Page(HTMLParser):
    """Text of a page and the pages that its body links to, without the navigation at the sides."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.file, self.text = file, ""
        self.links: set[Path] = set()
        html = file.read_text(encoding="utf-8")
        self.feed(html[html.index('<article role="main"') : html.index("</article>")])

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        address = dict(attrs).get("href") or ""
        if tag == "a" and not re.match(r"\w+:|#", address):
            self.links.add((self.file.parent / address.partition("#")[0]).resolve())

    def handle_data(self, data: str) -> None:
        self.text += data


def test_every_link_leads_to_a_page_of_the_site(site: Path) -> None:
    pages = [Page(file) for file in site.rglob("*.html") if file.name not in ("genindex.html", "search.html")]
    assert len(pages) > len(list(DOCS.rglob("*.md")))
    assert not [(page.file.name, link) for page in pages for link in page.links if not link.is_file()]


@pytest.mark.parametrize("question", QUESTIONS)
def test_the_index_leads_to_the_answer_within_two_clicks(site: Path, question: str) -> None:
    reached = {site / "index.html"}
    for _ in range(CLICKS):
        reached |= {link for file in reached for link in Page(file).links}
    assert any(QUESTIONS[question] in Page(file).text for file in reached)


def test_the_reference_has_every_message_and_every_public_name(site: Path) -> None:
    messages = Page(site / "reference" / "messages.html").text
    for file in MESSAGES.glob("*.msg"):
        assert file.read_text(encoding="utf-8").strip() in messages, file.name
    api = (site / "reference" / "python_api.html").read_text(encoding="utf-8")
    missing = [name for name in posor.__all__ if f'id="posor.{name}"' not in api]
    assert not missing


def test_a_broken_link_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "conf.py").write_text((DOCS / "conf.py").read_text(encoding="utf-8"), encoding="utf-8")
    page = "# Page\n\n[present](../data.csv), [lost page](lost.md), [lost file](../lost.csv), [lost part](#lost)\n"
    (tmp_path / "docs" / "index.md").write_text(page, encoding="utf-8")
    (tmp_path / "data.csv").touch()
    done = build(tmp_path / "docs", tmp_path / "output")
    assert done.returncode == 1
    named = [name for line in done.stderr.splitlines() for name in re.findall(r"'(\S*lost\S*)'", line)]
    assert named == ["lost.md", "../lost.csv", "lost"], done.stderr

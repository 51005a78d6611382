from __future__ import annotations

import base64
from html.parser import HTMLParser

from posor_estimator.reporting.html_page import (
    Cell,
    Section,
    bullet_list,
    definition_list,
    image,
    paragraph,
    render_page,
    table,
)

VOID = {"meta", "img", "br"}


class TagChecker(HTMLParser):
    """Checks that all tags are closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open_tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        assert attrs is not None
        if tag not in VOID:
            self.open_tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag


def test_page_is_well_formed_and_text_is_escaped() -> None:
    page = render_page(
        "a < b\nsecond line",
        "x & y hold.",
        holds=False,
        picture=image(b"PNG", 'curves "a"'),
        sections=(
            Section("Table <1>", table(("name", "<unit>"), [["a<b", Cell("no & no", "fails")]], "numbers")),
            Section("Text", paragraph("p<q") + bullet_list(["i<j"]) + definition_list({"k<l": "m<n"})),
        ),
    )
    checker = TagChecker()
    checker.feed(page)
    assert checker.open_tags == []
    assert page.startswith("<!DOCTYPE html>")
    for text in (
        "<title>a &lt; b</title>",
        "<h1>a &lt; b<br>second line</h1>",
        '<p class="verdict fails">x &amp; y hold.</p>',
        f'<img src="data:image/png;base64,{base64.b64encode(b"PNG").decode()}" alt="curves &#34;a&#34;">',
        "<h2>Table &lt;1&gt;</h2>",
        '<table class="numbers">',
        "<th>&lt;unit&gt;</th>",
        '<td>a&lt;b</td><td class="fails">no &amp; no</td>',
        "<p>p&lt;q</p><ul><li>i&lt;j</li></ul>",
        "<dt>k&lt;l</dt><dd>m&lt;n</dd>",
    ):
        assert text in page, text

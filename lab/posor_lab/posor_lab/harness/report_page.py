# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reads a report page: its problems, its texts, and the data that its plots offer for download."""

from __future__ import annotations

import csv
from html.parser import HTMLParser
from urllib.parse import unquote

MOST_BYTES = 5_000_000  # largest allowed size of a page
CSV_LINK = "data:text/csv;charset=utf-8,"
VOID_ELEMENTS = ("meta", "img", "br")


class ReportPage(HTMLParser):
    """A page whose tags nest, which loads nothing from elsewhere and is not too large, or else has problems."""

    def __init__(self, page: str) -> None:
        """Read a page."""
        super().__init__()
        self.problems: list[str] = []  # what is wrong with the page
        self.texts: list[str] = []  # texts outside of scripts and styles
        # rows of the CSV data of each plot, by the name of the downloaded file
        self.data: dict[str, list[dict[str, str]]] = {}
        self.links: set[str] = set()  # places of the page that its links name
        self.anchors: set[str] = set()  # places of the page that can be named
        self._open: list[str] = []
        self.feed(page)
        self.problems += [f"no place #{link}" for link in sorted(self.links - self.anchors)]
        self.close()
        size = len(page.encode())
        self.problems += [f"{tag} is open" for tag in self._open]
        self.problems += [f"{size} bytes"] if size > MOST_BYTES else []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Check the addresses of an element, and read the data of a link."""
        if tag not in VOID_ELEMENTS:
            self._open.append(tag)
        given = {name: value or "" for name, value in attrs}
        addresses = [given[name] for name in ("src", "href", "srcset", "action") if name in given]
        self.problems += [f"{tag}: {address}" for address in addresses if not address.startswith(("data:", "#"))]
        self.links |= {address[1:] for address in addresses if address.startswith("#")}
        self.anchors |= {given["id"]} if "id" in given else set()
        address = given.get("href", "")
        if address.startswith(CSV_LINK):
            text = unquote(address.removeprefix(CSV_LINK))
            self.data[given["download"]] = list(csv.DictReader(text.splitlines()))

    def handle_endtag(self, tag: str) -> None:
        """Check that the element is the newest open one."""
        if self._open.pop() != tag:
            self.problems.append(f"/{tag}")

    def handle_data(self, data: str) -> None:
        """Note a text; a style names no address."""
        parent = self._open[-1] if self._open else ""
        if parent == "style" and "url(" in data:
            self.problems.append(data)
        if parent not in {"script", "style"}:
            self.texts.append(data)

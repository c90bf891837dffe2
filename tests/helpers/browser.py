"""A browser that tests drive, if there is one (Debian: apt-get install chromium), and what a visitor meets in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SECOND = 1000
"""In milliseconds, as Playwright counts."""


@contextmanager
def chromium(*arguments: str) -> Iterator[Any]:
    """The machine's Chromium, started with more arguments; skips the test where it or Playwright is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no browser is driven without Playwright")
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this machine")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu", *arguments])
        yield found
        found.close()


class Visitor:
    """A visitor's page, with its browser's requests and error messages."""

    READY = "body"
    """What is there once the page can be used."""

    def __init__(self, tab: Any, address: str) -> None:
        self.tab = tab
        self.requests: list[str] = []
        self.problems: list[str] = []
        tab.set_default_timeout(60 * SECOND)
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.on("console", self.noted)
        tab.on("pageerror", lambda error: self.problems.append(str(error)))
        tab.goto(address)
        tab.locator(self.READY).wait_for()

    def noted(self, line: Any) -> None:
        """A line of the browser's console."""
        if line.type == "error":
            self.problems.append(line.text)

"""Headless Chromium by Playwright, for pictures of pages and their tests."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from eitskin.errors import InputError

if TYPE_CHECKING:
    from playwright.sync_api import Browser

PATIENCE_MS = 300_000  # long enough that a busy machine does not fail
NAMES = ("chromium", "chromium-browser", "google-chrome")


def installed() -> str | None:
    """The path of the first of NAMES that is installed, None without any."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def chromium() -> Iterator["Browser"]:
    """Context manager of a running browser.

    Raises InputError without Chromium, or without the Playwright of the test extra.
    """
    program = installed()
    if program is None:
        raise InputError("PATH", "chromium", "no such program", f"one of {', '.join(NAMES)}")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise InputError("python", "playwright", "not installed", "it, from .[test]") from error
    with sync_playwright() as playwright:
        # Only pages of the project are opened; as root, as in a container, there is no sandbox.
        browser = playwright.chromium.launch(
            executable_path=program, chromium_sandbox=False, timeout=PATIENCE_MS
        )
        try:
            yield browser
        finally:
            browser.close()

"""Pages opened in a Chromium without a window and without a network, and what they do there."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from manual import browser

INSIDE = ("data:", "blob:")
# Boxes that scroll hold what is wide; text in a picture is the picture's affair.
OUTSIDE = """() => [...document.querySelectorAll('body *')]
  .filter(one => !one.closest('svg') && !one.parentElement.closest('.wide'))
  .filter(one => one.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .map(one => `${one.tagName} ${one.className}: ${one.textContent.slice(0, 60)}`)"""
WIDER = "() => document.documentElement.scrollWidth - document.documentElement.clientWidth"
CUT = """() => [...document.querySelectorAll('.wide')]
  .filter(one => one.scrollWidth > one.clientWidth + 1).map(one => one.textContent.slice(0, 60))"""
# Contrast of WCAG 2 between the colour of each text and the first ground behind it.
PALE = """least => {
  const light = colour => {
    const [r, g, b] = colour.match(/[\\d.]+/g).slice(0, 3).map(each => each / 255)
      .map(each => each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = one => {
    for (; one; one = one.parentElement) {
      const colour = getComputedStyle(one).backgroundColor;
      if (!/, 0\\)$/.test(colour)) return colour;
    }
    return 'none';
  };
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const found = [];
  while (texts.nextNode()) {
    const one = texts.currentNode.parentElement;
    if (one.closest('svg') || !texts.currentNode.textContent.trim()) continue;
    const behind = ground(one);
    const both = [light(getComputedStyle(one).color), behind === 'none' ? 0 : light(behind)];
    const contrast = (Math.max(...both) + 0.05) / (Math.min(...both) + 0.05);
    if (contrast < least) found.push(`${contrast}: ${one.textContent.slice(0, 60)}`);
  }
  return found;
}"""


@contextmanager
def headless() -> Iterator[Any]:
    """Chromium; skips the calling test, loudly, where it is not installed."""
    if browser.installed() is None:
        warnings.warn("SKIPPED: no Chromium here; apt-get install chromium", stacklevel=2)
        pytest.skip("Chromium is not installed")
    with browser.chromium() as started:
        yield started


@dataclass(frozen=True)
class Opened:
    """A page, and what it asked for outside its own file, and what its console said, so far."""

    page: Any
    asked: list[str]
    said: list[str]


@contextmanager
def opened(started: Any, path: Path, **settings: Any) -> Iterator[Opened]:
    """A page on a file, without a network."""
    own = path.resolve().as_uri()
    context = started.new_context(offline=True, **settings)
    context.set_default_timeout(browser.PATIENCE_MS)
    page = context.new_page()
    shown = Opened(page, [], [])

    def note(request: Any) -> None:
        if request.url != own and not request.url.startswith(INSIDE):
            shown.asked.append(request.url)

    page.on("request", note)
    page.on("console", lambda message: shown.said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: shown.said.append(str(error)))
    page.goto(own)
    yield shown
    context.close()

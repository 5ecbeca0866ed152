"""Pages opened in a Chromium without a window and without a network, and what they do there."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from manual import browser

LOCAL = ("file:", "data:", "blob:")
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
def headless() -> Iterator:
    """Chromium; skips the calling test, loudly, where it is not installed."""
    if browser.installed() is None:
        warnings.warn("SKIPPED: no Chromium here; apt-get install chromium", stacklevel=2)
        pytest.skip("Chromium is not installed")
    with browser.chromium() as started:
        yield started


@contextmanager
def opened(started, path: Path, **settings) -> Iterator:
    """A page on a file, without a network; at the end it must have asked for nothing outside its
    file, and its console must have been silent."""
    context = started.new_context(offline=True, **settings)
    page = context.new_page()
    asked, said = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(path.resolve().as_uri())
    yield page
    context.close()
    assert [url for url in asked if not url.startswith(LOCAL)] == []
    assert [url for url in asked if url.startswith("file:")] == [path.resolve().as_uri()]
    assert said == []

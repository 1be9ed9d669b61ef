"""Draws the picture of a report that the documentation shows: `docs/images/report.png`.

python docs/screenshot.py runs/hidden_effect
"""

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

IMAGE = Path(__file__).resolve().parent / "images" / "report.png"


def main() -> None:
    """Open the report of a run in Chromium and store pictures of its verdict and of measured against predicted."""
    parser = argparse.ArgumentParser(description="Draw the picture of a report that the documentation shows.")
    parser.add_argument("run", help="run folder")
    report = Path(parser.parse_args().run).resolve() / "report.html"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1060, "height": 1000})
        page.goto(report.as_uri())
        page.wait_for_function("document.documentElement.dataset.ready === 'true'")
        top = page.screenshot(clip={"x": 0, "y": 0, "width": 1060, "height": 415})
        page.add_style_tag(content="nav { display: none }")
        middle = page.locator("#histories").screenshot()
        browser.close()
    parts = [Image.open(io.BytesIO(part)).convert("RGB") for part in (top, middle)]
    width = max(part.width for part in parts)
    whole = Image.new("RGB", (width, sum(part.height for part in parts)), "white")
    y = 0
    for part in parts:
        whole.paste(part, ((width - part.width) // 2, y))
        y += part.height
    # Few colours in a palette: a quarter of the size.
    whole.quantize(96).save(IMAGE, optimize=True)


if __name__ == "__main__":
    main()

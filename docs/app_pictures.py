"""Draws the pictures of the page `hsed app`: `docs/images/app_measurements.png` and `docs/images/app_effects.png`.

python docs/app_pictures.py RAW.csv FOLDER

RAW.csv is dropped into the page of FOLDER, and the first run that is there is opened.
"""

import argparse
import io
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

IMAGES = Path(__file__).resolve().parent / "images"


def main() -> None:
    """Serve the folder, drop the file, open the run, and store the pictures."""
    parser = argparse.ArgumentParser(description="Draw the pictures of hsed app.")
    parser.add_argument("raw", help="a file with a column of elongations and one of forces")
    parser.add_argument("folder", help="folder with a run in it; what is dropped goes there, too")
    given = parser.parse_args()
    code = "from hsed_jax.command_line import main; raise SystemExit(main())"
    served = subprocess.Popen(
        [sys.executable, "-c", code, "app", given.folder, "--no-browser"], stdout=subprocess.PIPE, text=True
    )
    assert served.stdout is not None
    served.stdout.readline()
    address = served.stdout.readline().strip()
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1180, "height": 800})
            page.goto(address)
            page.get_by_text("What was measured?").wait_for()
            page.locator("input[type=file]").first.set_input_files(given.raw)
            page.get_by_text("initial stiffness").wait_for()
            page.get_by_label("turn the sign of the force").check()
            page.get_by_text("a specimen cannot give energy").wait_for()
            _keep(page, "app_measurements")
            page.get_by_label("run", exact=True).select_option(index=1)
            page.locator(".bk-tab", has_text="4 Effects").click()
            page.locator("p", has_text="error 0").wait_for()
            page.get_by_label("pinching", exact=True).check()
            page.locator("p", has_text="and pinching").wait_for()
            _keep(page, "app_effects")
            browser.close()
    finally:
        served.send_signal(signal.SIGTERM)
        served.wait()


def _keep(page: Page, name: str) -> None:
    page.wait_for_timeout(1500)  # what moves comes to rest
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
    # Few colours in a palette: a quarter of the size.
    picture.quantize(128).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()

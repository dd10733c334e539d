"""Size of the report's page, and how fast it answers in headless Chromium.

    python benchmarks/report.py [ACTUATORS]

Run by hand, from the root of the project; needs chromium, chromedriver and selenium.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import report_data
from browser import Browser

from truenewton.report.investigate import investigate
from truenewton.report.page.page import write_report

AFTER_PAINT = """
const done = arguments[0], start = performance.now();
%s
requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(
  () => done(performance.now() - start))));
"""
ACTIONS = {
    "another layer": "document.querySelectorAll('#layers input')[3].click();",
    "a selection": "Bokeh.documents[0].get_model_by_name('actuators').selected.indices = [100];",
    "a filter": "const box = document.getElementById('wanted'); box.value = 'alpha > 1.05';"
    "box.dispatchEvent(new Event('input'));",
}


def main(actuators: int) -> None:
    """Print size and times of the page of a mirror of so many actuators."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        start = time.perf_counter()
        write_report(path, investigate(report_data.large(actuators)))
        made = time.perf_counter() - start
        print(f"{actuators} actuators: {path.stat().st_size / 1e6:.2f} MB, made in {made:.2f} s")
        browser = Browser(folder)
        start = time.perf_counter()
        browser.open(path)
        print(f"  opened in {time.perf_counter() - start:.2f} s")
        time.sleep(2.0)
        for name, action in ACTIONS.items():
            milliseconds = browser.driver.execute_async_script(AFTER_PAINT % action)
            print(f"  {name + ' is drawn after':<32}{milliseconds:4.0f} ms")
        browser.quit()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5352)

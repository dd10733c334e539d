"""A headless Chromium, and axe-core, where they are installed."""

import json
import os
import shutil
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
AXE = ROOT / ".browser" / "node_modules" / "axe-core" / "axe.min.js"
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
READY = "return document.documentElement.dataset.ready === 'true'"
# Where an actuator stands on the screen, in pixels of the window.
PIXEL = """
const [key, index] = arguments;
const source = Bokeh.documents[0].get_model_by_name("actuators");
const host = document.getElementById("plot-" + key);
host.scrollIntoView({ block: "center" });
const view = [...Bokeh.index.roots].find((view) => host.contains(view.el));
const [x, y] = { map: ["x", "y"], rings: ["number", "alpha"] }[key];
const box = view.el.getBoundingClientRect();
return [box.x + view.frame.x_scale.compute(source.get_column(x)[index]),
        box.y + view.frame.y_scale.compute(source.get_column(y)[index])];
"""
TOOLTIP = """
const found = [];
const walk = (node) => {
  for (const child of node.children) {
    if (child.classList.contains("bk-Tooltip") && child.getBoundingClientRect().width > 0) {
      found.push((child.shadowRoot ?? child).textContent);
    }
    if (child.shadowRoot) walk(child.shadowRoot);
    walk(child);
  }
};
walk(document.body);
return found.join(" | ");
"""


class Browser:
    """What a person does with the page, and what the page must not do."""

    def __init__(self, downloads):
        from selenium.webdriver import Chrome
        from selenium.webdriver.chrome.options import Options
        from selenium.webdriver.chrome.service import Service

        options = Options()
        options.binary_location = CHROMIUM
        for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                     "--window-size=1280,900"):  # fmt: skip
            options.add_argument(word)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = Chrome(options=options, service=Service(DRIVER))
        self.driver.execute_cdp_cmd(
            "Browser.setDownloadBehavior",
            {"behavior": "allow", "downloadPath": os.fspath(downloads)},
        )

    def quit(self):
        self.driver.quit()

    def js(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script, *arguments, seconds=20):
        """Wait until a script returns something true, and return it."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            found = self.js(script, *arguments)
            if found:
                return found
            time.sleep(0.05)
        raise AssertionError(f"never true: {script}")

    def open(self, path):
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        self.driver.get(Path(path).as_uri())
        if self.js("return document.getElementById('payload') !== null"):
            self.wait(READY)

    def narrow(self, width):
        """Be a phone of so many pixels' width."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": True},
        )

    def wide(self):
        self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})

    def complaints(self):
        """Return what the console was told of since the page was opened, notes aside."""
        return [e for e in self.driver.get_log("browser") if e["level"] not in ("INFO", "DEBUG")]

    def requests(self):
        """Return what the page asked the network for: neither itself nor its own data."""
        events = [json.loads(e["message"])["message"] for e in self.driver.get_log("performance")]
        urls = [e["params"]["request"]["url"] for e in events
                if e["method"] == "Network.requestWillBeSent"]  # fmt: skip
        assert urls  # the page itself at least, or nothing was recorded
        return [url for url in urls if not url.startswith(("file:", "data:", "blob:"))]

    def pointer(self, key, index, *, click=False):
        """Move to an actuator in a view, and click it if told to."""
        from selenium.webdriver.common.action_chains import ActionChains

        x, y = self.js(PIXEL, key, index)
        chain = ActionChains(self.driver)
        chain.w3c_actions.pointer_action.move_to_location(round(x) - 3, round(y))
        chain.w3c_actions.pointer_action.move_to_location(round(x), round(y))
        if click:
            chain.click()
        chain.perform()

    def axe(self):
        """Return the serious faults that axe-core finds."""
        self.js(AXE.read_text(encoding="utf-8"))
        violations = self.driver.execute_async_script(
            "const done = arguments[0]; axe.run().then((result) => done(result.violations))"
        )
        return [
            (fault["id"], fault["help"], [node["html"][:200] for node in fault["nodes"]])
            for fault in violations
            if fault["impact"] in ("serious", "critical")
        ]

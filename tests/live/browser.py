"""A headless Chromium for the tests of the page, driven by Selenium; all of Debian's packages."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
MISSING = "needs Debian's chromium and chromium-driver (apt install chromium chromium-driver) and the package selenium"
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--allow-file-access-from-files")


def has_browser() -> bool:
    """Return whether the tests can run here."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return False
    return CHROMIUM is not None and DRIVER is not None


class Page:
    """A page in the browser.

    Parameters
    ----------
    driver : selenium.webdriver.Chrome
    path : Path
        The page's file.
    """

    def __init__(self, driver: Any, path: Path) -> None:
        self.driver, self.path = driver, path

    def open(self, link: str = "", dark: bool = False, still: bool = True, path: Path | None = None) -> None:
        """Open the page anew, and wait until it is ready; `still`: for a reader who wants little motion, so paused."""
        features = {
            "color-scheme": "dark" if dark else "light",
            "reduced-motion": "reduce" if still else "no-preference",
        }
        media = [{"name": f"prefers-{name}", "value": value} for name, value in features.items()]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": media})
        self.driver.get("about:blank")  # else another link would not load the page anew
        self.driver.get(f"{(path or self.path).resolve().as_uri()}{link}")
        self.wait("return document.documentElement.dataset.ready === 'true'")

    def run(self, script: str, *arguments: Any) -> Any:
        """Return what a script returns; `app` is the page's application, `run` its present run."""
        before = "const app = globalThis.amulettLive, run = new Proxy({}, { get: (_, name) => app.run[name] });"
        return self.driver.execute_script(before + script, *arguments)

    def wait(self, script: str, *arguments: Any) -> Any:
        """Return what a script returns once that is true."""
        from selenium.webdriver.support.wait import WebDriverWait

        return WebDriverWait(self.driver, 60, 0.05).until(lambda _: self.run(script, *arguments))

    def promise(self, script: str, *arguments: Any) -> Any:
        """Return what an expression's promise gives, or ``{"error": text}``."""
        call = f"""
            const app = globalThis.amulettLive, done = arguments[arguments.length - 1];
            const fail = (error) => done({{ error: error.message }});
            Promise.resolve().then(() => {script}).then((value) => done({{ value }}), fail);
        """
        return self.driver.execute_async_script(call, *arguments)

    def find(self, selector: str) -> Any:
        """Return the first element of a CSS selector."""
        return self.driver.find_element("css selector", selector)

    def messages(self) -> str:
        """Return the messages that are shown."""
        return str(self.run("return document.getElementById('messages').innerText"))

    def errors(self) -> list[str]:
        """Return what the browser's console reports as errors since the last call."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def requests(self) -> list[str]:
        """Return the addresses that were asked for since the last call."""
        events = (json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance"))
        return [event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"]

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Give the page another size [px], as on a screen with `scale` pixels to one of CSS."""
        size = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)

    def place(self, angle: float, radius: float) -> tuple[int, int]:
        """Return a point of your arm's picture, from its middle [px], at an angle [rad] and a radius of the joint."""
        script = """
            const [angle, radius] = arguments, box = document.getElementById("mine-canvas").getBoundingClientRect();
            const at = (x, y) => Live.arm.toDrawing(x, y, box.width, box.height), zero = at(0, 0), one = at(1, 1);
            const x = Live.arm.JOINT[0] + radius * Math.cos(angle), y = Live.arm.JOINT[1] - radius * Math.sin(angle);
            const toPixels = (place, k) => (place - zero[k]) / (one[k] - zero[k]);
            return [toPixels(x, 0) - box.width / 2, toPixels(y, 1) - box.height / 2];
        """
        x, y = self.run(script, angle, radius)
        return round(x), round(y)


@contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser, and end it."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        driver.set_script_timeout(120)
        yield driver
    finally:
        driver.quit()

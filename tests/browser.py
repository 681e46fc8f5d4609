"""A headless Chromium for tests, driven by its DevTools protocol: pages at any width, screenshots while they live."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

needs_chromium = pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a headless Chromium")


class Page:
    """One page of a browser that runs, by the link to its socket."""

    def __init__(self, link: Any) -> None:
        self._link, self._asked = link, 0
        self._happened: set[str] = set()
        self.call("Page.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What a method of the protocol answers."""
        self._asked += 1
        self._link.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while True:
            answer = self._heard()
            if answer.get("id") == self._asked:
                assert "result" in answer, answer
                return dict(answer["result"])

    def _heard(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self._link.recv(timeout=120))
        self._happened.add(message.get("method", ""))
        return message

    def open(self, address: str, width: int, height: int) -> None:
        """Opens an address as a screen of that size shows it [px], and waits until it is loaded."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                  mobile=width < 700)
        self._happened.clear()
        self.call("Page.navigate", url=address)
        while "Page.loadEventFired" not in self._happened:
            self._heard()

    def value(self, script: str) -> Any:
        """What a JavaScript expression is."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def picture(self) -> np.ndarray:
        """What is seen ``(height, width, 3)``, 0 to 255."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.array(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


@contextmanager
def chromium(folder: Path) -> Iterator[Page]:
    """A browser with software WebGL and a profile in ``folder``; ends with the block."""
    connect = pytest.importorskip("websockets.sync.client").connect
    profile = folder / "profile"
    browser = subprocess.Popen(
        ["chromium", "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
         "--disable-sync", "--hide-scrollbars", "--remote-debugging-port=0", f"--user-data-dir={profile}",
         "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = profile / "DevToolsActivePort"
        until = time.monotonic() + 60.0
        while not (port_file.is_file() and port_file.read_text().strip()):
            assert browser.poll() is None, "the browser ended"
            assert time.monotonic() < until, "the browser does not come up"
            time.sleep(0.1)
        port = port_file.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30) as answer:
            address = next(target for target in json.load(answer) if target["type"] == "page")["webSocketDebuggerUrl"]
        with connect(address, max_size=100_000_000) as link:
            yield Page(link)
    finally:
        browser.terminate()
        browser.wait(30)

"""A headless Chromium, driven over the Chrome DevTools protocol: just as much as the tests need."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
)
STARTS_S = 30.0
MAX_WAIT_S = 60.0  # for a state; a machine with other work may take most of it
LOOK_S = 0.03


def chromium() -> str | None:
    """Where there is one."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    return None


class Browser:
    """One Chromium with a profile of its own."""

    def __init__(self, folder: Path) -> None:
        self._open = ExitStack()
        program = chromium()
        assert program is not None
        self._process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = folder / "DevToolsActivePort"
        end_s = time.monotonic() + STARTS_S
        while not (port.exists() and "\n" in port.read_text()):
            if time.monotonic() > end_s or self._process.poll() is not None:
                self.close()
                raise RuntimeError("Chromium did not start")
            time.sleep(LOOK_S)
        self._address = f"http://127.0.0.1:{port.read_text().split()[0]}"

    def open(self, url: str, size: tuple[int, int] = (1500, 1000)) -> Tab:
        """Another tab."""
        request = urllib.request.Request(f"{self._address}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=10) as answer:
            about = json.load(answer)
        tab = Tab(
            self._open.enter_context(
                connect(about["webSocketDebuggerUrl"], max_size=None, close_timeout=0.2, ping_interval=None)
            )
        )
        tab.resize(*size)
        tab.go(url)
        return tab

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._open.close()


class Tab:
    """One page. `requested` holds every address that it asked for, `said` what its scripts complained of."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._numbers = itertools.count(1)
        self.requested: list[str] = []
        self.said: list[str] = []
        for domain in ("Page", "Runtime", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """A command, and what it returns."""
        number = next(self._numbers)
        self._connection.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._connection.recv(timeout=MAX_WAIT_S))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._heard(message)

    def _heard(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requested.append(params["request"]["url"])
            case "Network.webSocketCreated":
                self.requested.append(params["url"])
            case "Runtime.exceptionThrown":
                self.said.append(json.dumps(params["exceptionDetails"])[:500])

    def go(self, url: str) -> None:
        self.send("Page.navigate", url=url)

    def reload(self) -> None:
        self.send("Page.reload")

    def resize(self, width: int, height: int) -> None:
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def run(self, script: str) -> Any:
        """The value of an expression."""
        found = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"]["exception"].get("description", "")[:300])
        return found["result"].get("value")

    def wait(self, script: str, timeout_s: float = MAX_WAIT_S) -> Any:
        """Until an expression is true."""
        end_s, value = time.monotonic() + timeout_s, None
        while time.monotonic() < end_s:
            try:
                value = self.run(script)
            except (RuntimeError, AssertionError):
                value = None  # between two pages there is none
            if value:
                return value
            time.sleep(LOOK_S)
        raise AssertionError(
            f"{script} did not come true within {timeout_s} s; the page says {self.text()[:900]}"
        )

    def text(self) -> str:
        return str(self.run("document.body.innerText"))

    def where(self, selector: str) -> tuple[float, float]:
        """The middle of something, once it can be used and stands still."""
        script = (
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "if (!e || e.disabled) return null;"
            "e.scrollIntoView({block: 'nearest'}); const b = e.getBoundingClientRect();"
            "return b.width ? [b.x + b.width / 2, b.y + b.height / 2] : null })()"
        )
        self.front()
        found, before = self.wait(script), None
        while found != before:
            time.sleep(2 * LOOK_S)
            found, before = self.wait(script), found
        return found[0], found[1]

    def front(self) -> None:
        """Show this tab; what is hidden draws nothing and opens no dialog."""
        self.send("Page.bringToFront")

    def press_at(self, x: float, y: float) -> None:
        """The mouse goes down, and up again."""
        for kind in ("mousePressed", "mouseReleased"):
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, selector: str) -> None:
        self.press_at(*self.where(selector))

    def key(self, name: str, code: int) -> None:
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    def type(self, selector: str, text: str) -> None:
        """Into an input, in place of what it holds."""
        self.press(selector)
        self.run(f"document.querySelector({json.dumps(selector)}).select()")
        self.send("Input.insertText", text=text)

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"]))

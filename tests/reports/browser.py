"""A small client of the DevTools protocol over a pipe: opens a page in headless Chromium and listens to all it says and asks for.

with Browser(executable, profile_folder) as browser:
    page = browser.open(path_of_page, width=390, dark=True)
    page.evaluate("document.title");  page.messages;  page.requests
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

# Far beyond what a page takes on a busy machine: reaching it means that the browser hangs.
_PATIENCE = 120.0
# The browser reads commands from descriptor 3 and writes to 4; a launcher puts our pipes there.
_LAUNCHER = """
import os, sys
reads, writes = os.dup(int(sys.argv[1])), os.dup(int(sys.argv[2]))
high = [os.open(os.devnull, os.O_RDONLY) for _ in range(6)]
reads, writes = os.dup(reads), os.dup(writes)
os.dup2(reads, 3); os.dup2(writes, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


class BrowserError(Exception):
    """The browser ended, hung, or refused a command."""


@dataclass
class Page:
    """An open page. messages: console output, exceptions and policy violations.

    requests: addresses asked for, the page's own first.
    """

    browser: Browser
    session: str
    messages: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    loaded: bool = False

    def call(self, method: str, **parameters: object) -> dict:
        return self.browser.call(method, self.session, **parameters)

    def evaluate(self, expression: str):
        """The value of a JavaScript expression; it must be plain JSON."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise BrowserError(f"{expression}: {json.dumps(answer['exceptionDetails'])[:500]}")
        return answer["result"].get("value")

    def press(self, key: str) -> None:
        for kind in ("keyDown" if key == "Enter" else "rawKeyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=key,
                windowsVirtualKeyCode={"Tab": 9, "ArrowRight": 39, "End": 35, "Enter": 13,
                                       " ": 32}.get(key, 0),
                                       **({"text": "\r"} if kind == "keyDown" else {}),
            )  # fmt: skip

    def heard(self, method: str, parameters: dict) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif method == "Runtime.consoleAPICalled":
            self.messages.append(json.dumps(parameters["args"]))
        elif method == "Runtime.exceptionThrown":
            self.messages.append(json.dumps(parameters["exceptionDetails"]))
        elif method == "Log.entryAdded":
            self.messages.append(parameters["entry"]["text"])
        elif method == "Page.loadEventFired":
            self.loaded = True


class Browser:
    """One headless Chromium with no network, killed at the end."""

    def __init__(self, executable: str, profile: Path) -> None:
        command_reads, command_writes = os.pipe()
        answer_reads, answer_writes = os.pipe()
        arguments = [
            executable,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            # Whatever the page might ask for leads nowhere.
            "--proxy-server=127.0.0.1:9",
            "--remote-debugging-pipe",
            f"--user-data-dir={profile}",
        ]
        self._process = subprocess.Popen(
            [sys.executable, "-c", _LAUNCHER, str(command_reads), str(answer_writes), *arguments],
            pass_fds=(command_reads, answer_writes),
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(command_reads)
        os.close(answer_writes)
        self._to, self._from = command_writes, answer_reads
        self._buffer = b""
        self._number = 0
        self._pages: dict[str, Page] = {}

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def open(
        self,
        path: Path,
        *,
        width: int = 1400,
        height: int = 1000,
        dark: bool = False,
        script: bool = True,
        fragment: str = "",
        metered: bool = False,
    ) -> Page:
        """Open a file of this machine and wait until it is loaded. metered: `Performance.getMetrics` then tells CPU seconds of its main thread."""
        target = self.call("Target.createTarget", None, url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", None, targetId=target, flatten=True)[
            "sessionId"
        ]
        page = self._pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            page.call(f"{domain}.enable")
        if metered:
            page.call("Performance.enable", timeDomain="threadTicks")
        page.call(
            "Network.emulateNetworkConditions",
            offline=True,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        page.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        page.call(
            "Emulation.setEmulatedMedia",
            features=[{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}],
        )
        if not script:
            page.call("Emulation.setScriptExecutionDisabled", value=True)
        page.call("Page.navigate", url=path.resolve().as_uri() + fragment)
        limit = time.monotonic() + _PATIENCE
        while not page.loaded:
            self._hear(limit)
        return page

    def call(self, method: str, session: str | None, **parameters: object) -> dict:
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters} | (
            {"sessionId": session} if session else {}
        )
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._to, data) :]
        limit = time.monotonic() + _PATIENCE
        while True:
            answer = self._hear(limit)
            if answer.get("id") == number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                return answer["result"]

    def _hear(self, limit: float) -> dict:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(0.0, limit - time.monotonic()))
            data = os.read(self._from, 1 << 20) if ready else b""
            if not data:
                raise BrowserError(
                    "the browser does not answer"
                    if not ready
                    else f"the browser ended ({self._process.poll()})"
                )
            self._buffer += data
        text, self._buffer = self._buffer.split(b"\0", 1)
        message = json.loads(text)
        page = self._pages.get(message.get("sessionId", ""))
        if page is not None and "method" in message:
            page.heard(message["method"], message.get("params", {}))
        return message

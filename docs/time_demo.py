"""Time the live demo's first answers in headless Chromium: ``python docs/time_demo.py FOLDER [RUNS]``.

FOLDER is ``demo`` of the built site, with pages, models and runtime. (The cache docs/_cache/demo has no runtime: no
page there is ever ready.) Each run opens a page anew, waits until the agent is ready, and gives it the page's first
photo. Besides the time until the answer is there it prints the processor time of the page's process with all its
threads: about what one quiet core would need, whatever else the machine does.
"""

import shutil
import statistics
import sys
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright


class Quiet(SimpleHTTPRequestHandler):
    """A server of files that logs nothing."""

    def log_message(self, *_: object) -> None:
        """Nothing."""


def processor_time(browser: Browser) -> float:
    """What all threads of the processes that run pages have used, in ms."""
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    return sum(1000 * process["cpuTime"] for process in processes if process["type"] == "renderer")


def main(folder: str, runs: str = "5") -> None:
    """Print a line a page, with medians."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    arguments = ["--no-sandbox", "--disable-gpu"]
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        for page in sorted(Path(folder).glob("viewer_*.html")):
            rows = []
            for _ in range(int(runs)):
                with browser.new_context() as context:
                    begun, tab = time.perf_counter(), context.new_page()
                    tab.goto(f"http://127.0.0.1:{server.server_port}/{page.name}")
                    tab.locator("#photo-said", has_text="The agent is ready").wait_for(timeout=120_000)
                    ready, used = time.perf_counter() - begun, processor_time(browser)
                    tab.click("#photos button:nth-child(1)")
                    tab.locator("#photo-said", has_text="Answered in").wait_for(timeout=60_000)
                    answered = int(tab.evaluate("document.body.dataset.answered"))
                    rows.append((1000 * ready, answered, processor_time(browser) - used))
            ready, answered, used = map(statistics.median, zip(*rows, strict=True))
            print(f"{page.stem}: ready {ready:.0f} ms, first answer {answered:.0f} ms, of processor {used:.0f} ms")
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])

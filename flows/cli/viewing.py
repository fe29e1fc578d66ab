"""What `slgaussian view` does: open a scene in the browser until it is told to stop."""

from __future__ import annotations

import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from flows.cli.questions import opened
from slgaussian.viewer.door import listen
from slgaussian.viewer.live import Page, load_viser
from slgaussian.viewer.session import Session


def view(source: Path, host: str, port: int | None, settings: Mapping[str, Any]) -> None:
    """Show a field or a ``.ply`` in the browser until Ctrl-C or SIGTERM.

    ``settings`` say, by the name of the field's encoder, where its files are now. The address goes
    to the standard output; a browser is opened where there is a desktop and somebody at a terminal.

    Raises
    ------
    SLGaussianError
        If the source cannot be opened, the port is in use, or viser is not installed.
    """

    def terminate(number: int, frame: object) -> NoReturn:
        raise KeyboardInterrupt

    # Of both: a shell that starts this in the background has it ignore SIGINT.
    before = {sign: signal.signal(sign, terminate) for sign in (signal.SIGINT, signal.SIGTERM)}
    page = None
    try:
        load_viser()
        door = listen(host, port)
        points = source.suffix.lower() == ".ply" and not source.is_dir()
        session = Session(source, None if points else opened(source, settings)[1])
        page = Page(session, door)
        print(door.address, flush=True)
        if door.token:
            print("whoever has this address sees the scene and can change it", file=sys.stderr)
        print("Ctrl-C ends it", file=sys.stderr)
        if sys.stdout.isatty() and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(door.address)
        # Now and then awake: a signal that comes just before it waits would else not end it.
        while not threading.Event().wait(1):
            pass
    except KeyboardInterrupt:
        # A second one must not leave the server half ended.
        for sign in before:
            signal.signal(sign, signal.SIG_IGN)
        lost = page is not None and page.session.unsaved
        print("\nstopped; changes were not saved" if lost else "\nstopped", file=sys.stderr)
    finally:
        if page is not None:
            page.stop()
        for sign, handler in before.items():
            signal.signal(sign, handler)
